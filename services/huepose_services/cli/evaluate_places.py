"""`huepose eval pairs places`: what colour pairs give in the full method, on sets of scenes."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from huepose.evaluation.colorpairs.place_figures import figures_of, place_lines, question_entry, question_of
from huepose.evaluation.colorpairs.place_study import Question, StudySet, study_places
from huepose.evaluation.colorpairs.places import PLACES
from huepose.evaluation.equivalents import read_equivalents
from huepose.evaluation.result_files import write_json
from huepose.evaluation.targets import Targets
from huepose.model import ReferenceModel, load_models
from huepose.support.errors import InputError
from huepose_services.cli.evaluate_scenes import open_bop
from huepose_services.runtime.config_text import read_yaml

KEYS = ("bop", "bundles", "objects", "equivalent", "seeds", "every")


def places(arguments: argparse.Namespace, models: Mapping[str, ReferenceModel]) -> Any:
    """Ask, print a table for each set, and return figures and questions. The file of results is written
    after every frame, and what it holds already is not asked again. Raises InputError."""
    sets = _sets(arguments, models)
    unknown = sorted(set(arguments.kinds or ()) - set(PLACES))
    if unknown:
        raise InputError("--kinds", found=f"'{unknown[0]}'", expected="some of " + ", ".join(PLACES))
    known = _known(arguments.json, [s.name for s in sets])

    def record(questions: Sequence[Question]) -> dict[str, Any]:
        figures = figures_of(questions) if questions else []
        return {"figures": [asdict(f) for f in figures], "questions": [question_entry(q) for q in questions]}

    def keep(questions: Sequence[Question]) -> None:
        write_json(arguments.json, {"places": {"questions": [question_entry(q) for q in questions]}})

    questions = study_places(sets, arguments.min_visib, arguments.kinds, known, keep)
    if not questions:
        raise InputError("the places", found="no label that is wanted, has a model and is visible enough")
    print(place_lines(figures_of(questions)))
    return record(questions)


def _sets(arguments: argparse.Namespace, models: Mapping[str, ReferenceModel]) -> list[StudySet]:
    if arguments.sets is not None:
        return _sets_of_file(arguments.sets, arguments.bundles)
    if not arguments.bop:
        raise InputError(
            "the places",
            found="no scenes",
            fix="Give labelled scenes with --bop, or sets of them with --sets.",
        )
    equivalents = read_equivalents(arguments.equivalent) if arguments.equivalent else {}
    targets = Targets(models, arguments.objects)
    return [StudySet("scenes", open_bop(arguments.bop), targets, equivalents, tuple(arguments.seed))]


def _sets_of_file(path: Path, bundles: Path) -> list[StudySet]:
    """The sets that a YAML file lists: {name: {bop: [DIR...], bundles: DIR, objects: [...], equivalent: FILE,
    seeds: [...], every: N}}, all but `bop` optional, folders relative to that of the file."""
    try:
        entries = read_yaml(path.read_text(), path)
    except OSError as error:
        raise InputError(path, found=error.strerror or str(error), expected="a YAML file of sets") from None
    if not isinstance(entries, dict) or not all(isinstance(entry, dict) for entry in entries.values()):
        raise InputError(path, found="no sets", expected="NAME: {bop: [SCENE_DIR, ...], ...}")
    out = []
    for name, entry in entries.items():
        unknown = sorted(set(entry) - set(KEYS))
        if unknown or not entry.get("bop"):
            found = f"'{unknown[0]}'" if unknown else "no 'bop'"
            raise InputError(f"{path}, set '{name}'", found=found, expected=", ".join(KEYS))
        scenes = open_bop([path.parent / scene for scene in entry["bop"]])
        models = load_models(path.parent / entry["bundles"] if "bundles" in entry else bundles)
        models = {model_name: m for model_name, m in models.items() if len(m.pairs.points)}
        equivalent = entry.get("equivalent")
        equivalents = read_equivalents(path.parent / equivalent) if equivalent else {}
        seeds = tuple(int(seed) for seed in entry.get("seeds", (0,)))
        targets, every = Targets(models, entry.get("objects")), int(entry.get("every", 1))
        out.append(StudySet(str(name), scenes, targets, equivalents, seeds, every))
    return out


def _known(path: Path, names: Sequence[str]) -> list[Question]:
    """What a file of results holds of these sets; raises InputError where it holds others."""
    if not path.exists():
        return []
    try:
        entries = json.loads(path.read_text()).get("places", {}).get("questions", [])
        known = [question_of(entry) for entry in entries]
    except (ValueError, AttributeError, TypeError, KeyError):
        raise InputError(
            path, found="a file that is no result of this study", fix="Move it away, or name another file."
        ) from None
    other = sorted({q.set for q in known} - set(names))
    if other:
        raise InputError(
            path, found=f"answers for the set '{other[0]}'", expected="those of " + ", ".join(names)
        )
    return known
