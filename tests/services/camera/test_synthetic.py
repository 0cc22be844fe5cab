"""Which scene is rendered of one's own objects."""

from dataclasses import replace

from huepose.model import save_model
from huepose_services.camera import synthetic
from huepose_services.runtime.config_file import load


def test_the_order_of_the_objects_does_not_change_the_scene(tea_box, tmp_path, monkeypatch):
    (tmp_path / "bundles").mkdir()
    for name in ("jar", "box"):
        save_model(replace(tea_box, name=name), tmp_path / "bundles" / f"{name}.huepose")
    monkeypatch.setattr(synthetic, "SyntheticScene", lambda seed, objects: list(objects))
    path, rendered = tmp_path / "pipeline.yaml", []
    for objects in ("[{name: jar}, {name: box}]", "[{name: box}, {name: jar}]", "[]"):
        path.write_text(f"bundles: bundles\nobjects: {objects}\ncamera: {{source: synthetic}}\n")
        rendered.append(synthetic.open_source(load(path)))
    assert rendered == [["box", "jar"]] * 3
