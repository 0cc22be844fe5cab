"""Models with what the estimator derives from them: built when first needed, once, from any thread."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass

from huepose.model.types import ReferenceModel, model_named
from huepose.propose.template_table import TemplateTable, build_table


@dataclass(frozen=True, eq=False)
class PreparedModel:
    """A model and its templates laid out for products (about 20 MB)."""

    model: ReferenceModel
    table: TemplateTable


class PreparedModels:
    """Models by name. Raises InputError for a name that is not there."""

    def __init__(self, models: Mapping[str, ReferenceModel]) -> None:
        self._models = dict(models)
        self._prepared: dict[str, PreparedModel] = {}
        self._lock = threading.Lock()

    @property
    def names(self) -> list[str]:
        """All names, sorted."""
        return sorted(self._models)

    def add(self, model: ReferenceModel) -> None:
        """Know one more model, or another one of that name."""
        with self._lock:
            self._models[model.name] = model
            self._prepared.pop(model.name, None)

    def remove(self, name: str) -> None:
        """Forget a model; nothing happens when it is not known."""
        with self._lock:
            self._models.pop(name, None)
            self._prepared.pop(name, None)

    def model(self, name: str) -> ReferenceModel:
        """The model of that name."""
        return model_named(self._models, name)

    def prepared(self, name: str) -> PreparedModel:
        """The model of that name, prepared."""
        model = self.model(name)
        with self._lock:
            if name not in self._prepared:
                self._prepared[name] = PreparedModel(model, build_table(model.templates, model.diameter_m))
            return self._prepared[name]
