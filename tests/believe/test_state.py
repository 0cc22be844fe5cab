"""A state equals the word that users know."""

import json

import pytest

from huepose import PoseEstimate, State


@pytest.mark.parametrize("state", State)
def test_a_state_compares_with_its_word_and_prints_as_it(state: State) -> None:
    word = state.name
    assert state == word
    assert {state: 1}[word] == 1
    assert (str(state), f"{state}", f"{state:10s}|") == (word, word, f"{word:10s}|")
    assert json.dumps({"state": state}) == json.dumps({"state": word})


def test_an_estimate_without_a_pose_is_lost() -> None:
    assert PoseEstimate("cup").state is State.LOST
