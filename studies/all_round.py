"""Draw scenes of random household objects that look the same all round, or from several sides: for
`studies.still` and `huepose eval`.

    .venv/bin/python -m studies.all_round --out OUT --seeds 511 512 513
    .venv/bin/python -m studies.still --bop OUT/apart OUT/heaps --images 8 --absent 0 \\
        --bundles OUT/bundles --json OUT/still.json

Of the objects of each seed (`studies.stress.objects`) those are taken whose reference model has equivalent
rotations. They stand apart, and lie in heaps.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from huepose.geometry import Mesh
from huepose.model import save_model
from huepose.scenes.rendered import SceneRanges, write_rendered_set
from studies.presence.fit import APART
from studies.stress.objects import household_meshes, learned

FRAMES = 8


def drawn(out: Path, seeds: list[int]) -> list[str]:
    """Write reference models and scenes of the objects of those seeds; their names."""
    meshes: dict[str, Mesh] = {}
    ids: dict[str, int] = {}
    for seed in seeds:
        made = household_meshes(seed)
        for name, model in learned(made, out / "learned").items():
            if len(model.equivalents) > 1:
                called = f"{name}s{seed}"
                meshes[called], ids[called] = made[name], len(ids) + 1
                numbered = replace(model, name=called, object_id=ids[called])
                (out / "bundles").mkdir(parents=True, exist_ok=True)
                save_model(numbered, out / "bundles" / f"{called}.huepose")
    write_rendered_set(out / "apart", meshes, ids, FRAMES, seeds[0], APART)
    write_rendered_set(out / "heaps", meshes, ids, FRAMES, seeds[0] + 1, SceneRanges())
    return list(meshes)


def main() -> None:
    """Draw what is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[511, 512, 513])
    given = parser.parse_args()
    print(", ".join(drawn(given.out, given.seeds)))


if __name__ == "__main__":
    main()
