"""What the README and its pages say can be done can be done."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra import compose
from oracles.scripts import configuration, load

from torchdt.data.npz import write_npz
from torchdt.data.recording import validate

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md"))]
CONFIGURED = ("track", "tune", "compare", "quality", "tart", "detection")


def blocks(language, page):
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL)


def commands(page):
    """Lines of a page, each with those that go on from it."""
    return [line for block in blocks("bash", page) for line in re.sub(r"\\\n\s*", "", block).splitlines()]


def jobs():
    """Words of the lines that start an experiment, each once."""
    lines = {line for page in PAGES for line in commands(page) if line.startswith("python experiments/")}
    found = [shlex.split(line, comments=True) for line in sorted(lines)]
    return [
        words for words in found if Path(words[1]).stem in CONFIGURED and "--config-dir" not in str(words)
    ]


JOBS = jobs()


def test_python_example(recording, settings, tmp_path, monkeypatch):
    (example,) = blocks("python", README)
    monkeypatch.chdir(tmp_path)
    write_npz("recording.npz", validate(step_s=recording.step_s, snapshots=recording.snapshots[:1]))
    names = {}
    exec(example, names)
    history = names["history"]
    assert history.declared[0, -1].any()
    truth = recording.truth[0, -1, 0]
    estimate = history.position[0, -1][history.declared[0, -1]]
    assert torch.cdist(estimate.double(), truth[None]).min() < 2  # degrees


def test_jobs_are_found():
    assert {Path(job[1]).stem for job in JOBS} == set(CONFIGURED)
    assert len(JOBS) >= 30


@pytest.mark.parametrize("job", JOBS, ids=" ".join)
def test_overrides_compose(job):
    if "hydra/launcher=ray_pool" in job:
        pytest.importorskip("ray", reason="needs torchdt[ray], which the test extra leaves out")
    script = Path(job[1]).stem
    load(script)  # it registers the schema of its configuration
    overrides = [word for word in job[2:] if not word.startswith("-")]
    if "-m" in job:
        overrides = [word.partition(",")[0] for word in overrides]
    with configuration():
        assert compose(script, overrides=overrides, return_hydra_config=True).hydra.job.chdir is False


def test_two_commands():
    first, second = (line for line in commands(README) if line.startswith("python3"))
    assert first.endswith("&& python experiments/track.py")
    assert second.endswith("&& python -m pytest -n 2")
    assert "python -m pytest -n 2\n" in (ROOT / ".ci" / "run").read_text()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text())
    inside = [link for link in links if not link.startswith("http")]
    assert len(inside) >= 5 or page != README
    assert [link for link in inside if not (page.parent / link).exists()] == []


def test_it_is_read_in_three_minutes():
    """Prose at 300 words a minute, code and tables beside it at a glance."""
    prose = re.sub(r"```.*?```|^\|.*?$", "", README.read_text(), flags=re.DOTALL | re.MULTILINE)
    assert len(prose.split()) <= 900


def test_every_folder_is_on_the_map():
    text = (ROOT / "docs" / "how_it_works.md").read_text()
    folders = {path.parent for path in (ROOT / "torchdt").glob("*/*.py")}
    assert [str(folder) for folder in folders if f"`torchdt/{folder.name}`" not in text] == []


def test_measured_default_is_what_a_run_of_the_default_is_about(settings):
    """The table names these numbers."""
    s = settings(small=False)
    numbers = (s.scenario.num_steps, len(s.field["element_depths"]), len(s.field["freqs"]))
    assert numbers == (292, 21, 7)
    assert (s.scenario.num_snapshots, s.scenario.snr_db, s.tracker.particles) == (3, 20, 1000)
    assert np.isclose(s.scenario.gospa_cutoff, 200)
