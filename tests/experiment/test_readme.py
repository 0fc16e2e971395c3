"""What the README says can be done can be done."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_module

from torchdt.scenario.npz import write_npz

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


COMMANDS = [line for block in blocks("bash") for line in block.splitlines()]
JOBS = [
    shlex.split(line, comments=True) for line in COMMANDS if line.startswith("python experiments/track.py")
]


def test_python_example(recording, settings, tmp_path, monkeypatch):
    (example,) = blocks("python")
    monkeypatch.chdir(tmp_path)
    one = recording.snapshots[:1]
    write_npz("recording.npz", type(recording)(step_s=recording.step_s, snapshots=one))
    names = {}
    exec(example, names)
    history = names["history"]
    assert history.declared[0, -1].any()
    truth = recording.truth[0, -1, 0]
    estimate = history.position[0, -1][history.declared[0, -1]]
    assert torch.cdist(estimate.double(), truth[None]).min() < 2  # degrees


def test_jobs_are_found():
    assert len(JOBS) >= 5


@pytest.mark.parametrize("job", JOBS, ids=" ".join)
def test_overrides_compose(job):
    overrides = [word for word in job[2:] if not word.startswith("-")]
    if "-m" in job:
        overrides = [word.partition(",")[0] for word in overrides]
    with initialize_config_module("torchdt.conf", version_base="1.3"):
        assert compose("track", overrides=overrides).runs >= 1


def test_two_commands():
    first, second = (line for line in COMMANDS if line.startswith("python3"))
    assert first.endswith("&& python experiments/track.py")
    assert second.endswith("&& python -m pytest")
    assert "python -m pytest\n" in (ROOT / ".ci" / "run").read_text()


def test_links_lead_somewhere():
    links = [link for link in re.findall(r"\]\(([^)]+)\)", README) if not link.startswith("http")]
    assert len(links) >= 5
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_every_folder_is_on_the_map():
    folders = {path.parent for path in (ROOT / "torchdt").glob("*/*.py")}
    assert [str(folder) for folder in folders if f"`torchdt/{folder.name}`" not in README] == []


def test_measured_default_is_what_a_run_of_the_default_is_about(settings):
    """The table names these numbers."""
    s = settings(small=False)
    numbers = (s.scenario.num_steps, len(s.field["element_depths"]), len(s.field["freqs"]))
    assert numbers == (292, 21, 7)
    assert (s.scenario.num_snapshots, s.scenario.snr_db, s.tracker.particles) == (3, 20, 1000)
    assert np.isclose(s.scenario.gospa_cutoff, 200)
