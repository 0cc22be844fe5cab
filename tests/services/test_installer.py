"""The installer for a Jetson: bundles, upgrades, and the way back."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
INSTALL = ROOT / "deploy" / "jetson" / "install.sh"


def _install(*arguments):
    return subprocess.run(["bash", str(INSTALL), *arguments], capture_output=True, text=True, timeout=60)


def test_a_dry_run_says_what_it_would_do_and_does_nothing():
    done = _install("--dry-run")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    (made,) = (line.split("--out ")[1].split()[0] for line in lines if "huepose units /etc/huepose/" in line)
    assert f"  cp -r {made}/. /etc/systemd/system" in lines
    assert any(line.strip() == "systemctl restart --no-block huepose.target" for line in lines)
    assert not Path("/etc/systemd/system/huepose.target").exists()
    assert not Path("/opt/huepose").exists()


def test_by_default_what_workers_and_the_gateway_need_is_installed():
    """The worker ros2 and `huepose secure` belong to the robot's own computer."""
    for line in (r'extras="(.*?)"', r"EXTRAS:-(.*?)}"):
        script = INSTALL if line.startswith("extras") else ROOT / "deploy" / "bundle.sh"
        assert {"edge", "viewer", "ros2", "secure"} <= set(re.search(line, script.read_text())[1].split())


def test_an_invalid_time_is_refused_before_anything_is_installed():
    done = _install("--dry-run", "--ready-within", "soon")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--ready-within is a number of seconds, not soon" in done.stderr


def test_a_bundle_is_installed_without_a_network_and_checked_by_its_hashes(tmp_path):
    shutil.copy(INSTALL, tmp_path)
    (tmp_path / "VERSION").write_text("0.1.0\n")
    done = subprocess.run(
        ["bash", str(tmp_path / INSTALL.name), "--dry-run"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if "pip install" in line]
    assert len(lines) == 2
    assert all(f"{tmp_path}/uv" in line and "--offline --no-index" in line for line in lines)
    assert "--require-hashes" in lines[0]
    assert "sync" not in done.stdout


def test_there_is_nothing_to_go_back_to_before_an_upgrade():
    done = _install("--dry-run", "--rollback")
    assert done.returncode == 2
    assert "no previous version" in done.stderr


@pytest.fixture
def two_versions(tmp_path):
    """A folder with two versions, the second in use with its units, and an installer for it that needs no
    root and whose systemctl only writes down its arguments. The programs are scripts."""
    places = " ".join(f"{name}={tmp_path / name}" for name in ("units", "rules", "home"))
    text = re.sub(r"^units=/etc.*$", places, INSTALL.read_text(), flags=re.MULTILINE)
    text = text.replace("/tmp/*) fail", "/nowhere/*) fail").replace("/run/systemd/system", str(tmp_path))
    (tmp_path / "install.sh").write_text(text)
    scripts = {"bin/id": "echo 0", "bin/systemctl": f'echo "$*" >> {tmp_path}/calls'}
    for number in (1, 2):
        # `huepose units FILE --out DIR --user NAME` writes a target; anything else succeeds.
        units = f'[ "$1" = units ] || exit 0\nmkdir -p "$4"\necho "of {number}" > "$4/huepose.target"'
        scripts[f"opt/releases/{number}/.venv/bin/huepose"] = units
    for name, lines in scripts.items():
        _script(tmp_path / name, lines)
    (tmp_path / "opt" / ".venv").symlink_to(tmp_path / "opt/releases/2/.venv")
    (tmp_path / "units" / "huepose@viewer.service.d").mkdir(parents=True)
    for name in ("huepose.target", "huepose@.service", "huepose@viewer.service.d/needs.conf"):
        (tmp_path / "units" / name).write_text("of 2\n")
    return tmp_path


def _script(path, lines):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{lines}\n")
    path.chmod(0o755)


def _roll_back(folder):
    return _run_installer(folder, "--rollback")


def _run_installer(folder, *arguments, umask=0o022):
    command = ["bash", str(folder / "install.sh"), *arguments, "--prefix", str(folder / "opt")]
    path = f"{folder / 'bin'}:{os.environ['PATH']}"
    return subprocess.run(
        command, env={**os.environ, "PATH": path}, capture_output=True, text=True, timeout=60, umask=umask
    )


def _files(folder):
    return {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("refuses", ["validate", "units"])
def test_if_the_previous_version_refuses_the_configuration_the_one_in_use_stays(two_versions, refuses):
    before = _files(two_versions / "units")
    old = two_versions / "opt/releases/1/.venv/bin/huepose"
    _script(old, f'[ "$1" != {refuses} ] || {{ echo "newkey: unknown" >&2; exit 2; }}')
    done = _roll_back(two_versions)
    assert done.returncode == 2
    assert "newkey: unknown" in done.stderr
    assert ("the installed version keeps running" in done.stderr) == (refuses == "validate")
    assert _files(two_versions / "units") == before
    assert (two_versions / "opt/.venv").readlink() == two_versions / "opt/releases/2/.venv"
    assert not (two_versions / "calls").exists()


def test_a_rollback_installs_the_units_of_that_version_and_runs_only_its_workers(two_versions):
    """A restart of the target restarts all workers that run, also one that it no longer names."""
    done = _roll_back(two_versions)
    assert done.returncode == 0, done.stderr
    assert _files(two_versions / "units") == {"huepose.target": "of 1\n"}
    assert (two_versions / "opt/.venv").readlink() == two_versions / "opt/releases/1/.venv"
    calls = (two_versions / "calls").read_text().splitlines()
    order = ["daemon-reload", "stop huepose@*.service", "restart --no-block huepose.target"]
    assert [line for line in calls if line in order] == order


def _bundle(folder, uv):
    """Make the folder a bundle of a third version; uv: the script that installs it."""
    for name, lines in {
        "bin/getent": "exit 0",
        "bin/usermod": "exit 0",
        "bin/udevadm": "exit 0",
        "bin/python3.11": "echo /usr/bin/python3",
        "uv": "for last; do :; done\n" + uv,
    }.items():
        _script(folder / name, lines)
    for name in ("VERSION", "pipeline.yaml", "70-huepose-cameras.rules"):
        (folder / name).write_text("3\n")


def test_the_services_can_read_the_programs_whatever_the_umask(two_versions):
    written = "#!/bin/sh\\n[ \\$1 = units ] || exit 0\\nmkdir -p \\$4\\necho > \\$4/huepose.target"
    program = f'printf "{written}" > "$VIRTUAL_ENV/bin/huepose"; chmod +x "$VIRTUAL_ENV/bin/huepose"'
    _bundle(two_versions, f'if [ "$1" = venv ]; then mkdir -p "$last/bin"; else {program}; fi')
    done = _run_installer(two_versions, umask=0o077)
    assert done.returncode == 0, done.stderr
    release = (two_versions / "opt/.venv").readlink().parent
    for path in (release, *release.rglob("*")):
        needed = 0o055 if path.is_dir() or path.name == "huepose" else 0o044
        assert path.stat().st_mode & needed == needed, path


@pytest.mark.parametrize("refuses", ["validate", "units"])
def test_if_the_new_version_is_refused_the_old_configuration_comes_back(two_versions, refuses):
    written = f"#!/bin/sh\\n[ \\$1 != {refuses} ]"
    program = f'printf "{written}" > "$VIRTUAL_ENV/bin/huepose"; chmod +x "$VIRTUAL_ENV/bin/huepose"'
    _bundle(two_versions, f'if [ "$1" = venv ]; then mkdir -p "$last/bin"; else {program}; fi')
    (two_versions / "home").mkdir()
    (two_versions / "home/pipeline.yaml").write_text("site: old\n")
    (two_versions / "new.yaml").write_text("site: new\n")
    before = _files(two_versions / "units")
    done = _run_installer(two_versions, "--config", str(two_versions / "new.yaml"))
    assert done.returncode == 2, done.stderr
    assert _files(two_versions / "home") == {"pipeline.yaml": "site: old\n"}
    assert _files(two_versions / "units") == before
    assert (two_versions / "opt/.venv").readlink() == two_versions / "opt/releases/2/.venv"


@pytest.mark.parametrize("version", ["3.10", "3.12"])
def test_a_bundle_is_installed_with_the_python_that_its_wheels_fit(two_versions, version):
    """Also if another one is there."""
    _bundle(two_versions, f'echo "$*" >> {two_versions}/uv_calls; exit 1')
    for name in ("3.10", "3.11", "3.12"):
        _script(two_versions / f"bin/python{name}", f"echo /usr/bin/python{name}")
    (two_versions / "PYTHON").write_text(f"{version}\n")
    assert _run_installer(two_versions).returncode == 1
    assert f"--python /usr/bin/python{version} " in (two_versions / "uv_calls").read_text()


def test_a_version_that_could_not_be_installed_is_not_the_previous_one(two_versions):
    """The disk is full after the environment was made."""
    _bundle(two_versions, '[ "$1" = venv ] || exit 1\nmkdir -p "$last"')
    assert _run_installer(two_versions).returncode == 1
    assert sorted(path.name for path in (two_versions / "opt/releases").iterdir()) == ["1", "2"]
    done = _run_installer(two_versions, "--rollback")
    assert done.returncode == 0, done.stderr
    assert (two_versions / "opt/.venv").readlink() == two_versions / "opt/releases/1/.venv"


def test_uninstalling_leaves_the_configuration():
    done = _install("--dry-run", "--uninstall")
    assert done.returncode == 0, done.stderr
    removed = [line for line in done.stdout.splitlines() if " rm " in line]
    assert len(removed) >= 3
    assert not any("/etc/huepose" in line or "/var/lib" in line for line in removed)


@pytest.mark.parametrize("prefix", ["relative", "/home/me/huepose", "/tmp/huepose"])
def test_a_prefix_that_the_services_cannot_see_is_refused(prefix):
    done = _install("--dry-run", "--prefix", prefix)
    assert done.returncode == 2
    assert prefix in done.stderr
