"""What gets installed: all packages, the configuration as `torchdt.conf`, the type marker."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

import torchdt

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[1]
WANTED = ("pyproject.toml", "README.md", "LICENSE", "torchdt", "conf")
COMPOSE = """
from pathlib import Path
from hydra import compose, initialize_config_module
import torchdt.conf, torchdt.app.track
with initialize_config_module("torchdt.conf", version_base="1.3"):
    print(compose("track", overrides=["scenario=line_array"]).scenario.name)
print(Path(torchdt.conf.__file__).parent)
"""


OWN = {
    "scenario/bay.yaml": "defaults: [line_array, _self_]\nname: bay\nsnr_db: 15.0\n",
    "field/four.yaml": "defaults: [line_array, _self_]\nsensor_positions: [0, 5, 10, 15]\n",
}
SMALL = ("scenario.num_steps=3", "tracker.particles=50", "tracker.slots=4", "logging=quiet")


def project():
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def run(*command, **options):
    done = subprocess.run(
        [sys.executable, *map(str, command)], capture_output=True, text=True, check=False, **options
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from a copy, which leaves the checkout as it is."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for name in WANTED:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, source / name)
    run("-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", folder, source)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def names(wheel):
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def test_no_package_is_forgotten():
    folders = {path.parent.relative_to(ROOT) for path in ROOT.glob("torchdt/**/*.py")}
    found = {".".join(folder.parts) for folder in folders} | {"torchdt.conf"}
    assert set(project()["tool"]["setuptools"]["packages"]) == found


def test_every_package_has_an_init():
    folders = {path.parent for path in ROOT.glob("torchdt/**/*.py")}
    assert [folder for folder in folders if not (folder / "__init__.py").exists()] == []


def test_wheel_holds_the_configuration(names):
    wanted = {f"torchdt/{path.relative_to(ROOT)}" for path in ROOT.glob("conf/**/*.yaml")}
    assert "torchdt/conf/scenario/swellex96.yaml" in wanted
    assert wanted <= names


def test_wheel_holds_the_code_and_nothing_else(names):
    code = {str(path.relative_to(ROOT)) for path in ROOT.glob("torchdt/**/*.py")}
    assert code | {"torchdt/py.typed", "torchdt/conf/__init__.py"} <= names
    metadata = f"torchdt-{torchdt.__version__}.dist-info"
    assert {name.partition("/")[0] for name in names} == {"torchdt", metadata}
    assert f"{metadata}/licenses/LICENSE" in names


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Folder of the wheel's content, out of sight of the checkout."""
    target = tmp_path_factory.mktemp("target")
    run("-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", target, wheel)
    return target


def test_installed_wheel_finds_its_configuration(installed, tmp_path):
    environment = os.environ | {"PYTHONPATH": str(installed)}
    name, folder = run("-c", COMPOSE, cwd=tmp_path, env=environment).split()
    assert name == "line_array"
    assert Path(folder) == installed / "torchdt" / "conf"


def test_installed_wheel_has_the_command(installed, tmp_path):
    environment = os.environ | {"PYTHONPATH": str(installed)}
    said = run(installed / "bin" / "torchdt", "--version", cwd=tmp_path, env=environment)
    assert said == f"torchdt {torchdt.__version__}\n"


def test_own_configuration_with_an_installed_wheel(installed, tmp_path):
    """A field and a scenario of one's own in a folder, on the package's command."""
    for name, content in OWN.items():
        (tmp_path / "mine" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "mine" / name).write_text(content)
    environment = os.environ | {"PYTHONPATH": str(installed)}
    command = (installed / "bin" / "torchdt", "track", "--config-dir=mine", "scenario=bay", "field=four")
    run(*command, *SMALL, "hydra.run.dir=run", cwd=tmp_path, env=environment)
    config = json.loads((tmp_path / "run" / "manifest.json").read_text())["config"]
    assert config["scenario"]["name"] == "bay"
    assert config["scenario"]["snr_db"] == 15
    assert len(config["field"]["sensor_positions"]) == 4
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["num_steps"] == 3


def test_constraints_name_every_requirement():
    pinned = dict(
        line.split("==")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if line and not line.startswith("#")
    )
    needed = project()["project"]
    extras = needed["optional-dependencies"]
    requirements = [*needed["dependencies"], *(name for extra in extras.values() for name in extra)]
    bare = {name.partition(">=")[0] for name in requirements if not name.startswith("torchdt[")}
    assert bare - {"stonesoup"} <= set(pinned)  # a peer, in no environment of tests
    assert pinned["torch"] == "2.13.0"


def test_extras_that_are_named_exist():
    texts = [
        *ROOT.glob("docs/*.md"),
        ROOT / "README.md",
        *ROOT.glob("conf/**/*.yaml"),
        *ROOT.glob("torchdt/**/*.py"),
    ]
    named = {name for text in texts for name in re.findall(r"torchdt\[(\w+)\]", text.read_text())}
    assert {"joblib", "slurm", "ray", "tune"} <= named
    assert named <= set(project()["project"]["optional-dependencies"])


def test_versions_agree():
    assert f"version: {torchdt.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert torchdt.__version__ in (ROOT / "CHANGELOG.md").read_text()
    assert version("torchdt") == torchdt.__version__
