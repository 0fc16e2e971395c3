"""What makes a run another one, and in which order it is marked as finished."""

import dataclasses
import math
from unittest import mock

import pytest

from torchdt.app.resume import RunCheckpoint, fingerprint_of
from torchdt.app.settings import TrackSettings
from torchdt.core.errors import InputError
from torchdt.run.checkpoint import save_checkpoint


def test_all_settings_count_on_which_numbers_depend(settings):
    found = {name.partition(".")[0] for name in fingerprint_of(settings())}
    known = {field.name for field in dataclasses.fields(TrackSettings)}
    assert known - found == {"logging", "threads", "workers", "memory_gb", "checkpoint_s"}


def test_contents_of_all_files_count(settings, tmp_path):
    """Of the data, their truth, the field, and others; what is not there is as good as a content."""
    paths = data, truth, env, other = [str(tmp_path / name) for name in ("data", "truth", "env", "other")]
    chosen = settings("data=sio", f"data.path={data}", f"data.truth={truth}", f"+field.env_file={env}")
    seen = []
    for path in (None, *paths):
        if path is not None:
            with open(path, "w") as file:
                file.write("content")
        contents = fingerprint_of(chosen, [other])
        seen.append([contents[f"content of {path}"] == "no file" for path in paths])
    assert seen == [[False] * done + [True] * (4 - done) for done in range(5)]


def test_without_an_interval_only_ends_are_kept_and_only_of_what_began_with_one(tmp_path):
    def keeper(every_s):
        return RunCheckpoint(tmp_path, {"seed": 0}, every_s).keeper(before=lambda: None)

    assert keeper(None) is None
    assert keeper(15.0).every_s == 15
    assert keeper(None).every_s == math.inf


def test_a_run_is_finished_before_its_state_is_taken_away(tmp_path):
    """One that is killed between the two does not begin anew."""
    checkpoint = RunCheckpoint(tmp_path, {"seed": 0}, 15.0)
    keeper = checkpoint.keeper(before=lambda: None)
    with mock.patch.object(keeper, "clear", side_effect=RuntimeError("killed")), pytest.raises(RuntimeError):
        checkpoint.finish(0.5, keeper)
    again = RunCheckpoint(tmp_path, {"seed": 0}, 15.0)
    assert (again.finished, again.score) == (True, 0.5)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"finished": "no", "score": None}, "content.finished: 'no', expected bool"),
        ({"finished": 1, "score": None}, "content.finished: 1, expected bool"),
        ({"finished": True, "score": "low"}, r"content.score: 'low', expected float \| None"),
        ({"finished": True}, "content: the keys finished, expected the keys finished, score"),
    ],
)
def test_a_checkpoint_that_does_not_say_whether_the_run_is_finished(tmp_path, content, words):
    save_checkpoint(tmp_path / "checkpoint.pt", "track", {"seed": 0}, content)
    with pytest.raises(InputError, match=rf"checkpoint.pt': found {words}; another folder starts anew"):
        RunCheckpoint(tmp_path, {"seed": 0}, 15.0)
