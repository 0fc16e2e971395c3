"""What docs/own_model.md says can be done can be done."""

import importlib
import json
import re
from pathlib import Path

import pytest
import torch
from oracles.line_array import make_region
from oracles.scripts import call, load

from torchdt.app.targets import PROTOCOLS
from torchdt.model.motion.base import Motion
from torchdt.model.motion.driving import Score

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "own_model.md").read_text()
FILES = re.findall(r"file `mine/([\w/.]+)`[^`]*```\w+\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """The page's files, under the names that it gives them, and on Python's path."""
    for name, text in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_files_are_found():
    assert [name for name, _ in FILES] == ["drag.py", "model/motion/drag.yaml"]
    assert len(FILES[0][1].splitlines()) < 40


def test_the_example_is_an_ornstein_uhlenbeck_process(mine):
    names = {}
    (python,) = [block for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL) if "Model(" in block]
    exec(python, names)
    motion = names["model"].on(make_region()).motion
    assert isinstance(motion, Motion)
    state = torch.tensor([[[1.0, 2.0]]], dtype=torch.float64)
    moved, _ = motion.predict(state, torch.zeros(1, 1, 1, dtype=torch.float64), 10.0, Score())
    expected = [
        1 + 2 * (1 - torch.exp(torch.tensor(-0.5)).item()) / 0.05,
        2 * torch.exp(torch.tensor(-0.5)).item(),
    ]
    torch.testing.assert_close(moved[0, 0], torch.tensor(expected, dtype=torch.float64))
    mean, covariance = motion.moments(state[0], torch.zeros(1, 2, 2, dtype=torch.float64), 10.0)
    torch.testing.assert_close(mean, moved[0])
    assert covariance[0, 1, 1].item() == pytest.approx(100 * motion.driving_variance.item())


@pytest.mark.parametrize("way", ["file", "target"])
def test_the_example_tracks_two_objects(mine, way):
    (command,) = re.findall(r"```bash\n(.*?)\n```", PAGE, re.DOTALL)
    assert command.startswith("PYTHONPATH=mine python experiments/track.py --config-dir=mine ")
    chosen = command.split("--config-dir=mine ")[1].split()
    if way == "target":
        (flat,) = re.findall(r"`(model\.motion\._target_=[^`]*)`", PAGE)
        chosen = [chosen[0], *flat.split()]
    overrides = ["logging=quiet", f"hydra.run.dir={mine}/run", "tracker.particles=100", "tracker.slots=4"]
    overrides += ["scenario.num_steps=6"]
    status, _, err = call(load("track"), f"--config-dir={mine}", *chosen, *overrides)
    assert status == 0, err
    assert json.loads((mine / "run" / "metrics.json").read_text())["gospa"]["mean"] < 10


def test_parts_of_the_page_exist():
    rows = re.findall(r"^\| `(\w+)` \| `([\w.]+)\.(\w+)` \| `(\w+)` \| (.*) \|$", PAGE, re.MULTILINE)
    found = {part: getattr(importlib.import_module(module), name) for part, module, name, _, _ in rows}
    assert found == PROTOCOLS
    for part, _, _, _, built_in in rows:
        presets = {path.stem for path in (ROOT / "conf" / "model" / part).glob("*.yaml")}
        assert set(re.findall(r"`(\w+)`", built_in)) <= presets


def test_links_lead_somewhere():
    links = re.findall(r"\]\(([^)]+)\)", PAGE)
    assert links
    assert [link for link in links if not (ROOT / "docs" / link).exists()] == []
