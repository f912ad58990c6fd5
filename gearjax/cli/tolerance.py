"""``gearjax tolerance``: a Monte Carlo study that can be resumed, on local devices or a cluster, and its tables."""

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tomli_w
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from gearjax.cli.tables import output, show
from gearjax.config import loads_tolerance
from gearjax.progress import EVERY, told_seconds
from gearjax.progress import Progress as Say
from gearjax.results.further import Further
from gearjax.results.needs import affordable
from gearjax.results.store import Store, held
from gearjax.results.tolerance import LISTED, ToleranceResults, finished, prepared
from gearjax.stopping import say_when_stopped
from gearjax.timing import Stopwatch
from gearjax.tolerance import Work
from gearjax.tolerance.monte_carlo import QUANTILES, Evaluated
from gearjax.tolerance.statistics import Estimate
from gearjax.units import arcmin

SELDOM = 0.2  # of the time since the start: lines of progress in a file become fewer


def use_all_cores() -> None:
    """Make one device of each core, so that the cores share the samples; no effect if JAX has its devices already."""
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)


def study(
    text: str, base: Path, folder: Path | None, scheduler: str | None, workers: int | None, console: Console, say: Say
) -> tuple[ToleranceResults, Work]:
    """Run or resume the study of a configuration.

    Args:
        text: the configuration.
        base: folder to which file names in the configuration are relative.
        folder: folder in which the samples are stored; ``None`` if they are not stored.
        scheduler: address of a Dask scheduler, ``"local"`` for one on this machine, or ``None``.
        workers: number of workers of a local Dask cluster, or ``None``.
        console: console of the progress bar.
        say: function that is called with lines of progress.

    Raises:
        GearjaxError: a mistake in the configuration.
    """
    unchanged = f"the files in {folder} are unchanged; run the same command to continue"
    if folder is not None and folder.is_dir():
        say_when_stopped(lambda: unchanged)
    if scheduler is None and workers is None:
        use_all_cores()
    tables, _, section = loads_tolerance(text, base)
    devices = len(jax.local_devices()) if scheduler is None and workers is None else workers or os.cpu_count() or 1
    say(affordable(section, devices, folder).words(stored=folder is not None))
    with contextlib.ExitStack() as stack:
        if folder is not None:
            stack.enter_context(held(folder))
            say_when_stopped(lambda: unchanged)
        work = prepared(section)
        if folder is None:
            kept: Kept | Store = Kept(work)
        else:
            kept = store = Store(folder, tables, work, text)
            say_when_stopped(lambda: _stored(store, folder))
            for words in store.remarks:
                say(words)
        if kept.samples_done:
            say(f"resuming: {kept.samples_done} of {work.number} samples are already computed")
        pending = kept.pending
        computed = sum(end - begin for begin, end in pending)
        with Stopwatch() as watch, _bar(console, work.number, kept.samples_done, say) as advance:
            if scheduler is None and workers is None:
                source: Any = work.each(pending)
            else:
                from gearjax.cli.cluster import each_on_cluster

                source = each_on_cluster(tomli_w.dumps(tables), pending, scheduler, workers, say)
            for chunk, evaluated in source:
                kept.put(chunk, evaluated)
                advance(chunk[1] - chunk[0], _good(work, evaluated))
        done = work.study(*kept.load(), watch)
        further = Further(folder, tables)
        return finished(section, work, done, watch.seconds, computed, further, say), work


def _stored(store: Store, folder: Path) -> str:
    """The message on what a stopped study has stored."""
    there = f"{store.samples_done} of {store.work.number} samples are saved in {folder}"
    return f"{there}; run the same command to continue"


class Kept:
    """Samples in memory, with the interface of a `Store`."""

    def __init__(self, work: Work):
        self.work, self.samples_done = work, 0
        self.values = np.full((work.number, len(work.names)), np.nan)
        self.codes = np.full(work.number, -1, np.int32)

    @property
    def pending(self) -> list[tuple[int, int]]:
        """All chunks."""
        return self.work.chunks

    def put(self, chunk: tuple[int, int], evaluated: Evaluated) -> None:
        """Keep a chunk."""
        self.values[slice(*chunk)], self.codes[slice(*chunk)] = evaluated

    def load(self) -> Evaluated:
        """Measures and result codes of all samples."""
        return self.values, self.codes


def _good(work: Work, evaluated: Evaluated) -> int:
    """Number of samples of a chunk that are within all limits; -1 if there are no limits."""
    within = [measure.holds(evaluated[0][:, i]) for i, measure in enumerate(work.measures) if measure.is_limited]
    return int(np.all(within, axis=0).sum()) if within else -1


class _Rate:
    """How many samples are done per second, and which share of them is within all limits.

    Args:
        total: number of samples of the study.
        done: number of samples that an earlier run has left.
    """

    def __init__(self, total: int, done: int):
        self.total, self.begun, self.reached, self.good = total, done, 0, 0
        self._began = time.monotonic()

    def after(self, number: int, good: int) -> str:
        """The rate in words after further samples, of which some are good; -1 without limits."""
        self.reached, self.good = self.reached + number, self.good + good
        words = f"{self.rate:,.0f} samples/s"
        return f"{words}, {100 * self.good / self.reached:.2f} % within all limits" if good >= 0 else words

    @property
    def rate(self) -> float:
        return self.reached / max(self.seconds, 1e-9)

    @property
    def seconds(self) -> float:
        return time.monotonic() - self._began

    @property
    def line(self) -> str:
        done = self.begun + self.reached
        return f"{done} of {self.total} samples, about {told_seconds((self.total - done) / self.rate)} left, "


@contextlib.contextmanager
def _bar(console: Console, total: int, done: int, say: Say) -> Iterator[Callable[[int, int], None]]:
    """A progress bar with samples per second, share within all limits and time left; lines of text, ever fewer of them,
    if it is not on a terminal."""
    rate = _Rate(total, done)
    if not console.is_terminal:
        due = EVERY

        def lines(number: int, good: int) -> None:
            nonlocal due
            words = rate.after(number, good)
            if rate.seconds >= due and done + rate.reached < total:
                due = rate.seconds + max(EVERY, SELDOM * rate.seconds)
                say(f"{rate.line}{words}")

        yield lines
        return
    columns = (TextColumn("samples"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"))
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as progress:
        task = progress.add_task("samples", total=total, completed=done, rate="")

        def advance(number: int, good: int) -> None:
            words = rate.after(number, good)
            progress.update(task, advance=number, rate=words)

        yield advance


def print_tolerance(results: ToleranceResults) -> None:
    """Print the tables of all studies that were made."""
    console, study_ = output(), results.study
    title = f"{study_.samples} gear sets, {results.section.sampler}, seed {results.section.seed}; in arcmin"
    table = Table(title=title)
    for column in ("measure", "mean", "std", *(f"{100 * level:g} %" for level in QUANTILES), "limit", "good [%]"):
        name = column == "measure"
        table.add_column(column, justify="left" if name else "right", no_wrap=name)
    for measure in study_.measures:
        cells = [f"{value / arcmin:.4f}" for value in (study_.mean(measure.name), study_.std(measure.name))]
        cells += [_interval(study_.quantile(measure.name, level), 1 / arcmin, 3) for level in QUANTILES]
        limits = [f"{s}{v / arcmin:g}" for s, v in (("<= ", measure.limit), (">= ", measure.at_least)) if v is not None]
        good = _interval(study_.share_within(measure.name), 100.0, 2) if measure.is_limited else ""
        table.add_row(measure.name, *cells, ", ".join(limits), good)
    show(console, table)
    for words, count in study_.faults.items():
        console.print(f"failed: {count} of {study_.samples}: {words}", soft_wrap=True)
    if len(study_.failed):
        listed = ", ".join(map(str, study_.failed[:LISTED].tolist()))
        more = "" if len(study_.failed) <= LISTED else " and more: code and number of each are in samples.zarr"
        console.print(f"failed samples: {listed}{more}", soft_wrap=True)
    for found in (results.impossible, results.clashes):
        if found is not None and found.told is not None:
            console.print(found.told, soft_wrap=True)
    for words in results.problems:
        console.print(f"not done: {words}", soft_wrap=True)
    for name, missed in results.missed.items():
        console.print(
            f"{name}: extremes between the samples differ by {missed / arcmin:+.2g} arcmin on average", style="dim"
        )
    _print_sensitivity(console, results)
    _print_allocation(console, results)
    _print_assembly(console, results)


def _interval(estimate: Estimate, scale: float, digits: int) -> str:
    value, low, high = (f"{scale * part:.{digits}f}" for part in estimate)
    return f"{value} [{low}, {high}]"


def _print_sensitivity(console: Console, results: ToleranceResults) -> None:
    for one in results.sensitivity:
        narrowed = results.tightened.get(one.name, {})
        table = Table(title=f"{one.name}: shares of its variance; {one.samples} gear sets for the Sobol indices")
        columns = ["number", "linear", "Sobol first", "Sobol total", "one at a time"]
        columns += ["halved: good [%]"] if narrowed else []
        for column in columns:
            table.add_column(column, justify="left" if column == "number" else "right")
        for i in np.argsort(-one.total):
            path = one.paths[i]
            cells = [f"{one.linear[i]:.3f}", f"{one.first[i]:.3f} ± {one.first_error[i]:.3f}"]
            cells += [f"{one.total[i]:.3f} ± {one.total_error[i]:.3f}", f"{one.one_at_a_time[i]:.3f}"]
            if narrowed:
                pair = narrowed.get(path)
                cells.append("" if pair is None else f"{100 * pair[0].value:.2f} to {100 * pair[1].value:.2f}")
            table.add_row(path, *cells)
        show(console, table)
        notes = [one.linear_fails] if one.linear_fails else []
        notes += ["this table ignores correlations"] if one.correlated else []
        if one.failed:
            notes += [f"{one.failed} of {one.samples} gear sets failed; the mean of the others replaces their values"]
        for words in notes:
            console.print(words, soft_wrap=True)


def _print_allocation(console: Console, results: ToleranceResults) -> None:
    bought = results.allocation
    if bought is None:
        return
    table = Table(title=f"Cheapest tolerances for {100 * bought.required:g} % within the limit of {bought.measure}")
    for column in ("tolerance", "factor"):
        table.add_column(column, justify="left" if column == "tolerance" else "right")
    for path, factor in zip(bought.paths, bought.factors, strict=True):
        table.add_row(path, f"{factor:.3f}")
    show(console, table)
    verdict = "proved" if bought.met else "NOT reached"
    console.print(
        f"cost {bought.cost_before:.4g} -> {bought.cost:.4g}; good {_interval(bought.before, 100.0, 2)} % -> "
        f"{_interval(bought.after, 100.0, 2)} %: {verdict}",
        soft_wrap=True,
    )


def _print_assembly(console: Console, results: ToleranceResults) -> None:
    matched = results.assembly
    if matched is None:
        return
    table = Table(title=f"{matched.measure.name} of {len(matched.random)} units, the same parts; in arcmin")
    for column in ("assembled", *(f"{100 * level:g} %" for level in QUANTILES), "good [%]"):
        table.add_column(column, justify="left" if column == "assembled" else "right")
    shares = matched.shares() if matched.measure.is_limited else (None, None)
    for place, (name, good) in enumerate(zip(("at random", "matched"), shares, strict=True)):
        cells = [_interval(matched.quantiles(level)[place], 1 / arcmin, 3) for level in QUANTILES]
        table.add_row(name, *cells, "" if good is None else _interval(good, 100.0, 1))
    show(console, table)
    if matched.failed:
        console.print(f"{matched.failed} units failed", soft_wrap=True)
