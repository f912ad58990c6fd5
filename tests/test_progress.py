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
