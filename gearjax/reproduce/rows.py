"""One published number next to ours."""

import dataclasses
import math


@dataclasses.dataclass(frozen=True)
class Row:
    """A published value, ours, and how the two compare.

    Args:
        item: where the value stands in the paper.
        published: the printed value, as text, so that its precision is kept; empty if the paper has none, and our
            value explains other values.
        computed: our value; nan if the paper does not give the data for it.
        unit: unit of both values.
        tolerance: deviation up to which the value counts as reproduced.
        inferred: whether it rests on constants that the paper does not give.
        why: what a reader should know about the deviation.
    """

    item: str
    published: str
    computed: float
    unit: str
    tolerance: float
    inferred: bool = False
    why: str = ""

    @property
    def deviation(self) -> float:
        """Computed minus published value; nan without a published value."""
        return self.computed - float(self.published) if self.published else math.nan

    @property
    def status(self) -> str:
        """``reproduced``, ``inferred``, ``not reproduced``, or ``not published``."""
        if not self.published:
            return "not published"
        if not math.isfinite(self.computed):
            return "not reproduced"
        if self.inferred:
            return "inferred"
        return "not reproduced" if self.is_beyond else "reproduced"

    @property
    def is_beyond(self) -> bool:
        """Whether the deviation is beyond the limit."""
        return not abs(self.deviation) <= self.tolerance

    @property
    def inferred_if_close(self) -> "Row":
        """The same row as one that rests on inferred constants: not reproduced, however, if it is beyond the limit."""
        return dataclasses.replace(self, inferred=self.status == "reproduced")

    def as_json(self) -> dict:
        """The row as ``gearjax reproduce --json`` prints it; a missing value is ``None``."""
        why = self.why or f"within {self.tolerance:.2g} {self.unit}"
        known = math.isfinite(self.computed)
        compared = known and bool(self.published)
        return {
            "item": self.item,
            "published": float(self.published) if self.published else None,
            "computed": self.computed if known else None,
            "unit": self.unit,
            "status": self.status,
            "why": f"deviation {self.deviation:+.4f} {self.unit}; {why}" if compared else why,
        }


def printed_precision(value: str) -> float:
    """One unit of the last printed digit: papers truncate as often as they round."""
    return 10.0 ** -len(value.partition(".")[2])
