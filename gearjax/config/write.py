"""Configurations with other numbers, such as those that a study has found."""

import copy
import re
from collections.abc import Mapping
from typing import Any

import tomli_w

from gearjax.config.build import read_tables
from gearjax.config.tables import written
from gearjax.parameters import Parameter

STUDIES = ("optimise", "tolerance", "published")  # sections that do not hold for the changed scene


def with_numbers(text: str, values: Mapping[str, float], parameters: Mapping[str, Parameter]) -> str:
    """The text of a configuration with other numbers, without the sections of studies and published values.

    Args:
        text: the configuration.
        values: numbers by path, such as ``errors.planet_1.phase``, SI.
        parameters: their declarations.

    Raises:
        GearjaxError: the text is not TOML.
    """
    tables: dict[str, Any] = copy.deepcopy(read_tables(text))
    for section in STUDIES:
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
