"""The named profiles: one source for the workers, the command line and the evaluation."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from typing import get_args, get_type_hints

import pytest

from huepose.estimation import Estimator, EstimatorConfig
from huepose.model.types import ReferenceModel
from huepose.perception.view_detector import ViewDetector
from huepose.profiles import NAMES, PROFILES, ProfileName, profile
from huepose.support.errors import InputError
from huepose.tracking import Tracker, TrackerConfig
from huepose_services.cli.main import build_parser
from huepose_services.runtime.config import Config


def test_the_default_settings_are_those_of_the_profile_live(tea_box: ReferenceModel) -> None:
    models = {"tea_box": tea_box}
    live = profile("live")
    assert Estimator(models).config == live.estimator == EstimatorConfig()
    assert Tracker(models).config == live.tracker == TrackerConfig()
    assert ViewDetector(models).config == live.detector


def test_a_pipeline_accepts_the_same_names_and_defaults_to_live() -> None:
    assert get_args(get_type_hints(Config)["profile"]) == get_args(ProfileName) == NAMES == tuple(PROFILES)
    assert Config().profile == "live"


@pytest.mark.parametrize(
    "command",
    [
        ["estimate", "--color", "c", "--depth", "d", "--camera", "k", "--bundles", "b"],
        ["eval", "estimate", "--bop", "s", "--bundles", "b", "--json", "j"],
        ["eval", "track", "--bop", "s", "--bundles", "b", "--json", "j"],
        ["eval", "perception", "--bop", "s", "--bundles", "b", "--json", "j"],
        ["bench"],
    ],
)
def test_every_measuring_command_defaults_to_live(command: list[str]) -> None:
    assert build_parser().parse_args(command).profile == "live"
    for name in NAMES:
        assert build_parser().parse_args([*command, "--profile", name]).profile == name


def test_a_profile_cannot_be_changed_and_an_unknown_one_is_refused() -> None:
    with pytest.raises(FrozenInstanceError):
        profile("live").tracker = TrackerConfig()
    with pytest.raises(InputError, match="profile: found 'fast'; expected 'live' or 'patient'"):
        profile("fast")
