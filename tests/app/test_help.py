"""`--help` says what a command does, what there is to choose, and how it is used."""

import re
from unittest import mock

import pytest
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.object_type import ObjectType
from oracles.scripts import call, configured, load

pytestmark = pytest.mark.slow
JOBS = sorted(configured("*.yaml"))
GROUPS = sorted({path.parent.name for path in configured("*/*.yaml").values()})


@pytest.fixture(scope="module", autouse=True)
def listed_once():
    """The groups are those of all jobs, and Hydra takes more than a second to list them."""
    known, list_options = {}, ConfigLoaderImpl.get_group_options

    def options(loader, group_name, results_filter=ObjectType.CONFIG):
        key = group_name, results_filter
        if key not in known:
            known[key] = list_options(loader, *key)
        return known[key]

    with mock.patch.object(ConfigLoaderImpl, "get_group_options", options):
        yield


@pytest.fixture(scope="module", params=JOBS)
def text(request):
    status, out, err = call(load(request.param), "--help")
    assert (status, err) == (0, "")
    return request.param, out


def test_begins_with_what_it_does(text):
    job, out = text
    assert out.startswith(f"{job}: ")
    assert "powered by Hydra" not in out


def test_examples_call_this_command(text):
    job, out = text
    examples = out.partition("Examples")[2].partition("Usual settings")[0]
    assert f"torchdt {job} " in examples or f"python experiments/{job}.py" in examples


def test_groups_and_their_options(text):
    lines = text[1].splitlines()
    for group in GROUPS:
        (line,) = (line for line in lines if line.startswith(f"{group}: "))
        options = set(configured(f"{group}/*.yaml"))
        assert set(line.partition(": ")[2].split(", ")) == options


def test_usual_settings_exist(text):
    """The names before `=` are keys of the configuration or groups."""
    out = text[1]
    usual = out.partition("Usual settings:\n")[2].partition("\n\n")[0]
    keys = [word.partition("=")[0] for line in usual.splitlines() for word in line.split() if "=" in word]
    assert len(keys) >= 4
    settings = out.partition("\nSettings, ")[2].splitlines()
    names = {line.split(":")[0].strip(" -") for line in settings} | set(GROUPS)
    parts = {f"{path.parent.parent.name}/{path.parent.name}" for path in configured("*/*/*.yaml").values()}
    assert [key for key in keys if key.rpartition(".")[2] not in names | parts] == []


def test_launchers(text):
    listed = text[1].partition("hydra/launcher=NAME")[2].partition("+experiment=NAME")[0]
    assert set(configured("hydra/launcher/*.yaml")) <= set(re.split(r"[\s,]+", listed))


def test_narrow_enough_for_a_terminal(text):
    """Lists of options apart, which are as long as they are."""
    lines = [
        line for line in text[1].partition("\nSettings")[0].splitlines() if line.split(":")[0] not in GROUPS
    ]
    assert max(map(len, lines)) <= 120
