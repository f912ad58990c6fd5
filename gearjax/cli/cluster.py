"""Chunks of a study on the workers of a Dask cluster: lost chunks are computed again, and none counts twice."""

import functools
import logging
import os
from collections.abc import Iterator, Sequence
from typing import Any

import jax

from gearjax.checks import GearjaxError
from gearjax.config import loads_tolerance
from gearjax.progress import Progress
from gearjax.results.tolerance import prepared
from gearjax.tolerance import Work
from gearjax.tolerance.monte_carlo import Evaluated

CONNECT = "30s"
LOCAL = "local"


@functools.lru_cache(maxsize=2)
def _work(text: str) -> Work:
    return prepared(loads_tolerance(text)[2])


def evaluate(text: str, chunk: tuple[int, int]) -> Evaluated:
    """Compute one chunk of the study of a configuration, in a worker that keeps the compiled program."""
    jax.config.update("jax_enable_x64", True)
    work = _work(text)
    return work.evaluate(work.inputs(*chunk))


def each_on_cluster(
    text: str,
    chunks: Sequence[tuple[int, int]],
    scheduler: str | None,
    workers: int | None,
    say: Progress,
) -> Iterator[tuple[tuple[int, int], Evaluated]]:
    """Compute chunks on a Dask cluster, and yield each chunk with its result as soon as it is done.

    Args:
        text: the configuration, with measured values written out in the text.
        chunks: the chunks to compute.
        scheduler: address of a running scheduler; ``None`` or ``"local"`` for a local cluster.
        workers: number of processes of the local cluster.
        say: function that is called with lines of progress.

    Raises:
        GearjaxError: dask is missing, the scheduler cannot be reached, or a chunk failed on every worker.
    """
    try:
        from distributed import Client, LocalCluster, as_completed
        from distributed.scheduler import KilledWorker
    except ImportError as fault:
        raise GearjaxError('--scheduler and --workers need dask: pip install "gearjax[dask]"') from fault
    cluster: Any = None
    if scheduler is None or scheduler == LOCAL:
        # a process ended by Ctrl-C leaves semaphores; Python removes them, and its warning is not shown
        os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker:UserWarning")
        cluster = LocalCluster(
            n_workers=workers or os.cpu_count() or 1,
            threads_per_worker=1,
            processes=True,
            dashboard_address="",
            silence_logs=logging.CRITICAL,  # workers that Ctrl-C ends may log a traceback; faults of chunks are raised
        )
    try:
        client = Client(cluster or scheduler, timeout=CONNECT)
    except (OSError, TimeoutError, ValueError) as fault:
        raise GearjaxError(f"--scheduler {scheduler}: cannot be reached ({fault})") from fault
    try:
        say(f"cluster: {scheduler if cluster is None else cluster.scheduler_address}")
        config = client.scatter(text, broadcast=True) if len(text) > 100_000 else text
        futures = {client.submit(evaluate, config, chunk, pure=False): chunk for chunk in chunks}
        for future in as_completed(list(futures)):
            try:
                evaluated = future.result()
            except KilledWorker as fault:
                words = "the workers that computed them died: is there enough memory?"
                raise GearjaxError(f"samples {futures[future]}: {words}") from fault
            except Exception as fault:  # whatever a worker raised: a missing package, a lost scheduler
                raise GearjaxError(f"samples {futures[future]}: {type(fault).__name__}: {fault}") from fault
            yield futures.pop(future), evaluated
    finally:
        client.close()
        if cluster is not None:
            cluster.close()
