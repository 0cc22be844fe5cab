"""Which scene is drawn of one's own objects."""

from dataclasses import replace

from huepose.model import save_model
from huepose_services.camera import synthetic
from huepose_services.runtime.config import load


def test_the_same_objects_are_the_same_scene_in_any_order(tea_box, tmp_path, monkeypatch):
    (tmp_path / "bundles").mkdir()
    for name in ("jar", "box"):
        save_model(replace(tea_box, name=name), tmp_path / "bundles" / f"{name}.huepose")
    monkeypatch.setattr(synthetic, "SyntheticScene", lambda seed, objects: list(objects))
    path, drawn = tmp_path / "pipeline.yaml", []
    for objects in ("[{name: jar}, {name: box}]", "[{name: box}, {name: jar}]", "[]"):
        path.write_text(f"bundles: bundles\nobjects: {objects}\ncamera: {{source: synthetic}}\n")
        drawn.append(synthetic.open_source(load(path)))
    assert drawn == [["box", "jar"]] * 3
