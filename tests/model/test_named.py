import pytest

from huepose.model.types import ReferenceModels
from huepose.support.errors import InputError


def test_a_known_model_is_given_and_an_unknown_name_lists_the_known(tea_box) -> None:
    models = {"tea_box": tea_box, "a_can": tea_box}
    assert ReferenceModels(models)["tea_box"] is tea_box
    with pytest.raises(InputError, match=r"object 'mug'.*one of a_can, tea_box"):
        ReferenceModels(models)["mug"]
    with pytest.raises(InputError, match="no objects at all"):
        ReferenceModels({})["mug"]
