"""Configurations with changed numbers, such as the numbers that a study has found."""

import copy
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import tomli_w

from gearjax.config.build import read_tables, with_files
from gearjax.config.tables import written
from gearjax.parameters import Parameter

STUDIES = ("optimise", "identify", "tolerance", "published")  # sections that are not valid for the changed scene


def self_contained(text: str, folder: str | Path) -> str:
    """The text of a configuration in a form that does not depend on a folder; unchanged if it names no files.

    Args:
        text: the configuration.
        folder: folder to which file names in the configuration are relative.

    Raises:
        GearjaxError: the text is not TOML, or a file that the text names cannot be read.
    """
    tables = read_tables(text)
    whole = with_files(tables, Path(folder))
    return text if whole == tables else tomli_w.dumps(whole)


def with_numbers(
    text: str,
    values: Mapping[str, float],
    parameters: Mapping[str, Parameter],
    folder: str | Path = ".",
    without: Iterable[str] = (),
) -> str:
    """The text of a configuration with changed numbers, without the sections of studies and of published values.

    Args:
        text: the configuration.
        values: new numbers by path, such as ``errors.planet_1.phase``, in SI.
        parameters: declarations of these numbers, by path.
        folder: folder to which file names in the text are relative; the new text does not depend on the folder.
        without: further sections to leave out.

    Raises:
        GearjaxError: the text is not TOML, or a file that the text names cannot be read.
    """
    tables: dict[str, Any] = copy.deepcopy(with_files(read_tables(text), Path(folder)))
    for section in (*STUDIES, *without):
        tables.pop(section, None)
    for path, value in values.items():
        *parents, last = path.split(".")
        table = tables
        for parent in parents:
            table = table.setdefault(parent, {})
        number = written(value, parameters[path])
        series = re.fullmatch(r"(.*)\[(\d+)\]", last)
        if series:
            table[series[1]][int(series[2])] = number
        else:
            table[last] = number
    return tomli_w.dumps(tables)
