"""Configurations: TOML files that list what a scene models and what to compute."""

from gearjax.config.build import load, loads, read_file

__all__ = ["load", "loads", "read_file"]
