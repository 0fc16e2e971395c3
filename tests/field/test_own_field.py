"""What docs/own_field.md says can be done can be done."""

import json
import re
from pathlib import Path

import pytest
import torch
from oracles.scripts import call, load, track_settings
from oracles.waveguide import ENV_FILE

from torchdt.app.targets import build_field
from torchdt.field import Field

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "own_field.md").read_text()
FILES = re.findall(r"file `mine/([\w/.]+)`[^`]*(?:`line_array`[^`]*)?```\w+\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """The page's files, under the names that it gives them, and on Python's path."""
    for name, text in FILES:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_files_are_found():
    assert [name for name, _ in FILES] == ["ring.py", "field/ring.yaml", "scenario/ring.yaml"]
    assert len(FILES[0][1].splitlines()) < 30


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_example_follows_the_protocol(dtype):
    names = {}
    exec(FILES[0][1], names)
    field = names["Ring"]([800.0, 1100.0], 0.25, 8, dtype=dtype)
    assert isinstance(field, Field)
    state = torch.tensor([[10.0, 0.1], [200.0, 0.0]], dtype=dtype).expand(3, 2, 2)
    response = field(state)
    assert response.shape == (3, 2, 2, 8)
    assert response.dtype == dtype.to_complex()
    torch.testing.assert_close(response[1, 1], field(state[1, 1]))


def test_example_tracks_two_objects(mine):
    """To 0.5 to 1 degree with seeds 0 to 5; missing one object costs 5 degrees a step."""
    (command,) = [line for line in re.findall(r"```bash\n(.*?)\n```", PAGE) if "scenario=ring" in line]
    assert command == "PYTHONPATH=mine python experiments/track.py --config-dir=mine scenario=ring"
    overrides = ["logging=quiet", f"hydra.run.dir={mine}/run", "tracker.particles=200", "tracker.slots=4"]
    status, _, err = call(load("track"), f"--config-dir={mine}", "scenario=ring", *overrides)
    assert status == 0, err
    scores = json.loads((mine / "run" / "metrics.json").read_text())
    assert scores["gospa"]["mean"] < 2


def test_example_of_an_environment_file(tmp_path, monkeypatch):
    """The command of the page finds the waveguide of the page's file."""
    (text,) = re.findall(r"file `coast.env`:\n\n```text\n(.*?)```", PAGE, re.DOTALL)
    assert text == ENV_FILE.read_text()
    (tmp_path / "coast.env").write_text(text)
    monkeypatch.chdir(tmp_path)
    (command,) = [line for line in re.findall(r"```bash\n(.*?)\n```", PAGE) if "env_file" in line]
    script, *overrides = command.removeprefix("python ").split()
    assert script == "experiments/track.py"
    chosen = track_settings(*overrides, "field.freqs=[49]", small=False)
    field = build_field(chosen.field, torch.float64, "cpu")
    assert field.water_depth == 216.5
    assert not chosen.calibration.enabled


def test_targets_of_the_page_exist():
    from torchdt.field import build

    targets = re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE)
    assert len(targets) == 4
    assert all(hasattr(build, name) for name in targets)


def test_links_lead_somewhere():
    links = re.findall(r"\]\(([^)]+)\)", PAGE)
    assert links
    assert [link for link in links if not (ROOT / "docs" / link).exists()] == []
