"""Whether existence can be trusted: `python experiments/reliability.py --help`.

Tracks sequences that are drawn from the tracker's own model, faint objects among them, and counts by tenths
of their probability of existence how many potential objects exist.
"""

import argparse

from hydra import initialize_config_module

from studies.reliability import model_of, potential_objects, print_tenths, tenths
from torchdt.app.build import build_recording, build_tracker
from torchdt.app.parallel import track_in_chunks
from torchdt.app.report.console import plain_console
from torchdt.app.suite import compose_track
from torchdt.core.errors import InputError
from torchdt.core.trees import tree_map


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="line_faint_model", help="with a population")
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--every", type=int, default=20, help="steps from one look at the objects to the next"
    )
    parser.add_argument("overrides", nargs="*", help="of the configuration of experiments/track.py")
    given = parser.parse_args()
    with initialize_config_module("torchdt.conf", version_base="1.3"):
        plain = compose_track(given.scenario, given.overrides, given.seed, given.runs)
        population = plain.scenario.population
        if population is None:
            raise InputError.of_key("scenario", given.scenario, "one with a population")
        overrides = [*model_of(population), *given.overrides]
        settings = compose_track(given.scenario, overrides, given.seed, given.runs)
    recording = build_recording(settings)
    tracker = build_tracker(settings, recording)
    tracked = track_in_chunks(settings, recording, tracker, range(given.seed, given.seed + given.runs))
    history, scenario = tree_map(lambda part: part.cpu(), tracked), settings.scenario
    assert recording.truth is not None
    steps = range(given.every - 1, recording.num_steps, given.every)
    found = potential_objects(history, recording.truth, steps, scenario.gospa_cutoff, scenario.distance)
    print_tenths(plain_console(), tenths(*found))


if __name__ == "__main__":
    main()
