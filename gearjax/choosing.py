"""Parts of a scene that can be modelled at several accuracies."""

from collections.abc import Mapping

import equinox as eqx


class Choosing(eqx.Module):
    """A part of a scene that declares which simpler or more exact models of itself there are."""

    def choices(self) -> Mapping[str, "Choosing"]:
        """The same part at each accuracy, by name in a configuration's words, the most exact one last.

        The mapping is empty if there is only one accuracy.
        """
        return {}
