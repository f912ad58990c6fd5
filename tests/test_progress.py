"""Progress of long computations: how long they still take, in words."""

import threading

import jax
import jax.numpy as jnp
import pytest

from gearjax import progress
from gearjax.timing import Stopwatch


def test_the_rest_of_the_time_follows_from_the_parts_that_are_done(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    left = progress.Left(50)
    now[0] = 103.0
    assert left.after() == ""  # too early to tell
    now[0] = 110.0
    assert left.after(9) == ", about 40 s left"
    now[0] = 140.0
    assert left.after(30) == ", about 10 s left"
    now[0] = 149.5
    assert left.after(9) == ", about 1 s left"
    assert left.after() == ""


def test_parts_that_are_done_at_once_have_times_of_their_own(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    left = progress.Left(60.0)  # of which one part of 30 is done beside the others
    now[0] = 20.0
    assert left.after(10.0, took=10.0) == ", about 50 s left"
    now[0] = 30.0
    assert left.after(30.0, took=30.0) == ", about 20 s left"
    now[0] = 50.0
    assert left.after(10.0) == ", about 10 s left"


def test_a_search_tells_now_and_then_how_far_it_is(monkeypatch):
    """The first evaluation compiles: it does not count for the time left."""
    now, lines = [0.0], []
    for clock in ("perf_counter", "monotonic"):
        monkeypatch.setattr(progress.time, clock, lambda: now[0])
    search = progress.Searching(lines.append, "motions", 40)
    for at, evaluations in ((60.0, 2), (63.0, 2), (66.0, 2), (100.0, 24), (110.0, 12)):
        now[0] = at
        search(evaluations)
    assert lines == ["6 motions, about 50 s left", "30 motions, about 10 s left", "42 motions"]


def test_a_search_that_may_end_early():
    left = progress.Left(2, "at most")
    left._last -= 50.0
    assert left.after() == ", at most 50 s left"


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(1.4, "1 s"), (9.4, "9 s"), (12, "10 s"), (96, "100 s"), (130, "2 min"), (5000, "83 min"), (9000, "2.5 h")],
)
def test_times_in_words(seconds, words):
    assert progress.told_seconds(seconds) == words


def test_a_stopwatch_counts_the_compilation_of_its_own_thread():
    watches = {}

    def compiled(name: str) -> None:
        with Stopwatch() as watches[name]:
            jax.jit(lambda x: jnp.sin(x) * len(name))(1.0).block_until_ready()

    with Stopwatch() as own:
        threads = [threading.Thread(target=compiled, args=(name,)) for name in ("one", "another")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert own.compile_seconds == 0
    assert all(watch.compile_seconds > 0 for watch in watches.values())
