"""What `train` says while it searches: each try when it is over, and the best error so far."""

from friction_hil.cli.work.train import Tries
from friction_hil.training import Progress


def test_each_try_is_one_line_with_its_lowest_error_and_the_best_so_far():
    tries = Tries()
    given = (("series-parallel", 0, 0.9), ("trial", 0, 0.4), ("trial", 0, 0.6), ("trial", 1, 0.5), ("parallel", 0, 0.1))
    steps = [Progress(stage, start, 2, 1, 10, 0.5, error, 1e-2) for stage, start, error in given]

    lines = [line for step in steps for line in tries.take(step)] + tries.end()

    assert lines == [
        "trying start 1 of 2: error 0.4000, best so far 0.4000",
        "trying start 2 of 2: error 0.5000, best so far 0.4000",
        "continuing start 1 of 2: error 0.1000, best so far 0.1000",
    ]
    assert Tries().end() == []
