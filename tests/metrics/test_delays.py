import torch
from oracles.histories import line_history

from torchdt.metrics import track_delays

NAN = float("nan")


def delays(sources, tracks, **options):
    """Of sources and tracks on a line, K positions each, NaN while absent; tracks are labelled from 1."""
    truth = torch.tensor(sources).double().T[..., None]
    place = torch.tensor(tracks).T
    label = torch.where(place.isnan(), 0, torch.arange(1, len(tracks) + 1))
    history = line_history(label.tolist(), place.nan_to_num().tolist())
    return track_delays(history, truth, **({"cutoff": 2.0} | options))


def test_late_tracks_that_outlive_their_sources():
    sources = [[0.0] * 4 + [NAN] * 2, [NAN, 50.0, 50.0, 50.0, NAN, NAN]]
    tracks = [[9.0, 1.0, 1.0, 1.0, 1.0, NAN], [NAN, NAN, 50.0, 50.0, 50.0, 50.0]]
    assert delays(sources, tracks) == ([1, 1], [1, 2])


def test_perfect_tracks():
    sources = [[0.0] * 4 + [NAN] * 2, [NAN, 50.0, 50.0, 50.0, 50.0, 50.0]]
    assert delays(sources, sources) == ([0, 0], [0])  # the second goes on living


def test_source_never_found():
    sources = [[0.0] * 4 + [NAN] * 2, [NAN, 50.0, 50.0, 50.0, NAN, NAN]]
    assert delays(sources, [[NAN] * 6]) == ([4, 3], [])


def test_source_that_is_never_there():
    assert delays([[NAN] * 3, [0.0] * 3], [[0.0] * 3]) == ([0], [])


def test_source_lost_before_its_death():
    """What is left of the track then is a false one, not a late one."""
    assert delays([[0.0, 0.0, 0.0, NAN]], [[0.0, 0.0, 30.0, 30.0]]) == ([0], [])


def test_the_estimate_must_be_nearer_than_the_cutoff():
    sources, tracks = [[0.0] * 3], [[5.0, 2.0, 1.9]]
    assert delays(sources, tracks).birth == [2]
    assert delays(sources, tracks, cutoff=2.1).birth == [1]


def test_each_estimate_finds_one_source():
    assert delays([[0.0] * 3, [1.0] * 3], [[0.4, 0.4, 0.4], [NAN, NAN, 1.0]]).birth == [0, 2]


def test_order_of_the_assignment():
    """Both at 1 and 1.2, or one at 0, one beyond the cutoff: the sums are 2.2 > 2, of squares 2.44 < 4."""
    sources, tracks = [[0.0] * 2, [1.0] * 2], [[1.0] * 2, [2.2] * 2]
    assert delays(sources, tracks).birth == [2, 0]
    assert delays(sources, tracks, order=2.0).birth == [0, 0]


def test_a_track_may_change_slots():
    truth = torch.tensor([0.0, 0.0, NAN, NAN]).double()[:, None, None]
    history = line_history([[7, 0], [0, 7], [7, 0], [0, 0]], [[0.0, 9], [9, 0], [0, 9], [9, 9]])
    assert track_delays(history, truth, cutoff=2.0) == ([0], [1])


def test_another_label_does_not_prolong_a_track():
    truth = torch.tensor([0.0, 0.0, NAN, NAN]).double()[:, None, None]
    history = line_history([[7], [7], [8], [8]], [[0.0]] * 4)
    assert track_delays(history, truth, cutoff=2.0) == ([0], [0])
