"""Recordings of a test bench: their comparison with a scene, and the identification of errors that explain them."""

from gearjax.identification.advice import Suggestion
from gearjax.identification.compare import Comparison, OrderBeside, RecordBeside, compare
from gearjax.identification.found import Identification, IdentifiedNumber
from gearjax.identification.identify import identify
from gearjax.identification.measurement import Measurement
from gearjax.identification.orders import Drift, Order
from gearjax.identification.posterior import Posterior, posterior
from gearjax.identification.reassembly import Gain, Reassembly, reassemble
from gearjax.identification.synthetic import synthetic_measurement
from gearjax.identification.unknowns import Unknowns
from gearjax.identification.visible import Combination, Visible

__all__ = [
    "Combination",
    "Comparison",
    "Drift",
    "Gain",
    "Identification",
    "IdentifiedNumber",
    "Measurement",
    "Order",
    "OrderBeside",
    "Posterior",
    "Reassembly",
    "RecordBeside",
    "Suggestion",
    "Unknowns",
    "Visible",
    "compare",
    "identify",
    "posterior",
    "reassemble",
    "synthetic_measurement",
]
