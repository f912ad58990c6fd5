"""Example configurations are part of a wheel, but not of an installation from a clone, which has them beside it."""

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Examples(BuildHookInterface):
    def initialize(self, version, build_data):
        if version == "standard":
            build_data["force_include"]["configs"] = "gearjax/examples"
