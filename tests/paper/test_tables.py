"""The tables of the paper's method: complete if requested, else an error says how to make them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.model.types import ReferenceModel
from huepose.paper.tables import reference_cloud, tables_of
from huepose.support.errors import InputError


def test_a_model_has_all_tables(tea_box: ReferenceModel) -> None:
    tables = tables_of(tea_box)
    assert len(tables.side_classes) == tea_box.pairs.parameters["coarse_pairs"]
    assert 0 < len(tables.triangle_keys) <= 200_000
    assert 0 < len(tables.ppf_keys) <= 200_000
    assert (np.diff(tables.triangle_keys) >= 0).all()
    assert (np.diff(tables.ppf_keys) >= 0).all()
    assert tables.triangles.max() < len(tables.cloud_points)
    assert tables.ppf.max() < len(tables.cloud_points)
    assert 3 <= len(tables.centers) <= 8
    assert tables.cloud_classes.max() < len(tables.centers)
    assert len(reference_cloud(tables)) == len(tables.cloud_points)


def test_a_model_without_them_says_how_to_get_them(tea_box: ReferenceModel) -> None:
    with pytest.raises(InputError, match=r"'tea_box': found no tables .*huepose onboard.* and --paper"):
        tables_of(replace(tea_box, tables=None))
