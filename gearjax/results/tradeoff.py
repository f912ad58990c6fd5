"""Results of ``gearjax tradeoff`` as JSON and CSV."""

from pathlib import Path

from gearjax.files import write_file
from gearjax.studies.tradeoff import Measured, Tradeoff
from gearjax.units import arcmin


def tradeoff_as_json(config: str, tradeoff: Tradeoff) -> dict:
    """The object that ``gearjax tradeoff --json`` prints."""
    return {
        "config": config,
        "error_arcmin": tradeoff.error / arcmin,
        "truth": {"metrics": _metrics(tradeoff.truth), "seconds": tradeoff.truth_seconds},
        "settings": [
            {
                "group": row.group,
                "name": row.name,
                "error_arcmin": row.error / arcmin,
                "seconds": row.seconds,
                "gradient_seconds": row.gradient_seconds,
                "gradient_measured": row.gradient_measured,
                "compile_seconds": row.compile_seconds,
                "metrics": _metrics(row.metrics),
            }
            for row in tradeoff.rows
        ],
        "static_choices": [
            {
                "part": choice.part,
                "name": choice.name,
                "error_arcmin": choice.error / arcmin,
                "force_error": choice.force_error,
                "seconds": choice.seconds,
                "compile_seconds": choice.compile_seconds,
            }
            for choice in tradeoff.statics
        ],
        "recommended": None if tradeoff.best is None else f"{tradeoff.best.group}: {tradeoff.best.name}",
    }


def _metrics(metrics: dict[float, dict[str, float]]) -> list[dict]:
    return [
        {"torque_Nm": torque} | {f"{name}_arcmin": value / arcmin for name, value in values.items()}
        for torque, values in metrics.items()
    ]


def save_tradeoff(tradeoff: Tradeoff, folder: Path) -> list[Path]:
    """Write ``tradeoff.csv`` and ``static_choices.csv``, as far as there is something to write.

    Raises:
        GearjaxError: the folder cannot be written.
    """
    files = {"tradeoff.csv": _of_settings(tradeoff), "static_choices.csv": _of_choices(tradeoff)}
    return [write_file(folder / name, "\n".join(lines) + "\n") for name, lines in files.items() if len(lines) > 1]


def _of_choices(tradeoff: Tradeoff) -> list[str]:
    lines = ["part,choice,error [arcmin],force error [-],run [s],compile [s]"]
    for one in tradeoff.statics:
        numbers = one.error / arcmin, one.force_error, one.seconds, one.compile_seconds
        lines.append(",".join([one.part, one.name, *(f"{number:.6g}" for number in numbers)]))
    return lines


def _of_settings(tradeoff: Tradeoff) -> list[str]:
    lines = ["group,setting,error [arcmin],run [s],gradient [s],compile [s],gradient measured"]
    lines += [
        f"{row.group},{row.name.replace(',', ';')},{','.join(_numbers(row))},{_how(row)}" for row in tradeoff.rows
    ]
    return lines


def _how(row: Measured) -> str:
    return "" if row.gradient_seconds is None else "yes" if row.gradient_measured else "no"


def _numbers(row: Measured) -> list[str]:
    numbers = (row.error / arcmin, row.seconds, row.gradient_seconds, row.compile_seconds)
    return ["" if number is None else f"{number:.6g}" for number in numbers]
