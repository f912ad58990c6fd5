"""Orders of a curve: which bodies have them, and which orders a model does not explain."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from gearjax.identification.rows import Rows
from gearjax.scene import Scene

SIGNIFICANT = 12.0  # Fisher's F ratio of a significant order, two degrees of freedom
PER_OUTPUT_TURN = 60  # highest order that is tried, in cycles per turn of the output
MULTIPLES = 3  # multiples of the bodies' orders that are tried
NEIGHBOURS = np.arange(2, 10)  # waves more or less in a recording: orders whose squares tell the noise beside one
LEFT = 0.01  # share of a wave's square that the model's derivatives must leave: below, they can take its place


@dataclasses.dataclass(frozen=True)
class Order:
    """A wave that a model does not explain.

    Args:
        order: cycles per turn of the input.
        name: name such as ``output`` or ``13 per turn of the output``.
        body: the body that has this order, in words.
        amplitude: amplitude of the wave [arcmin].
        phase: phase of its cosine at input angle zero [rad].
        significance: Fisher's F ratio.
    """

    order: float
    name: str
    body: str
    amplitude: float
    phase: float
    significance: float


def candidates(scene: Scene, theta: np.ndarray, record: np.ndarray) -> dict[float, tuple[str, str]]:
    """Orders that are tried, with their names and bodies.

    Of orders that are too close for a recording to distinguish, only the one of the lower multiple is tried.
    """
    orders = {name: order for name, order in scene.system.orders.items() if order > 0}
    output = orders.get("output", 1.0)
    span = max(float(np.ptp(theta[record == i])) for i in np.unique(record)) / (2 * np.pi)
    step = float(np.median(np.abs(np.diff(theta))))
    found: dict[float, tuple[str, str]] = {}

    def add(order: float, name: str, body: str) -> None:
        if order * step < np.pi and order * span > 0.9 and all(abs(order - other) * span > 0.3 for other in found):
            found[order] = name, body

    for times in range(1, MULTIPLES + 1):
        for name, order in ({"input": 1.0} | orders).items():
            body = f"the {name}" if name != "output" else "the output, what is mounted on it, or its encoder"
            body = body if name != "input" else "the input, or its encoder"
            add(times * order, name if times == 1 else f"{times} x {name}", body)
    for times in range(1, PER_OUTPUT_TURN + 1):
        add(
            times * output,
            f"{times} per turn of the output",
            "no body of the gear set: the test rig, or a shift of its zero",
        )
    return found


def unexplained(
    residual: np.ndarray, weight: np.ndarray, jacobian: np.ndarray, rows: Rows, scene: Scene
) -> list[Order]:
    """Orders in the residual of a model, the most significant one first.

    Of each wave, only the part orthogonal to the model's derivatives counts: the model can represent the rest itself.
    It must be larger than the noise of all rows, and than that of the orders beside it.

    Args:
        residual: measured minus computed [arcmin].
        weight: weights of the rows.
        jacobian: derivatives of the model.
        rows: the rows of the residual.
        scene: the scene whose bodies have the orders.
    """
    known = candidates(scene, rows.theta, rows.record)
    root = np.sqrt(weight)
    size = np.linalg.norm(jacobian * root[:, None], axis=0)
    base, values, _ = np.linalg.svd(jacobian * root[:, None] / np.where(size > 0, size, 1.0), full_matrices=False)
    base = base[:, values > 1e-6 * values[0]]
    left = root * residual
    left = left - base @ (base.T @ left)
    freedom = max(rows.theta.size - base.shape[1] - 2, 1)
    span = max(float(np.ptp(rows.theta[rows.record == i])) for i in np.unique(rows.record)) / (2 * np.pi)
    found = []
    for order, (name, body) in known.items():
        waves = np.stack([np.cos(order * rows.theta), np.sin(order * rows.theta)], axis=1) * root[:, None]
        beside = waves - base @ (base.T @ waves)
        if (beside**2).sum() < LEFT * (waves**2).sum():
            continue
        parts, *_ = np.linalg.lstsq(beside, left, rcond=None)
        gained = float(((beside @ parts) ** 2).sum())
        rest = max(float((left**2).sum()) - gained, 1e-300) / freedom
        ratio = gained / 2 / rest
        if ratio > SIGNIFICANT:
            ratio = min(ratio, gained / 2 / max(_beside(order, span, root, rows.theta, left), 1e-300))
        amplitude, phase = float(np.hypot(*parts)), float(np.arctan2(-parts[1], parts[0]))
        found.append(Order(order, name, body, amplitude, phase, ratio))
    return sorted(found, key=lambda each: -each.significance)


def _beside(order: float, span: float, root: np.ndarray, theta: np.ndarray, left: np.ndarray) -> float:
    """Square of the noise near an order: successive rows may hang together, so that slow waves of noise are larger.

    It is the median over neighbours that a recording can tell from the order, so that a few waves among them count
    little.
    """
    near = order + np.concatenate([-NEIGHBOURS, NEIGHBOURS]) / span
    near = near[near * span > 0.9]
    parts = np.exp(1j * np.outer(near, theta)) @ (root * left)
    squares = np.abs(parts) ** 2 / max(float((root**2).sum()), 1e-300)
    return float(np.median(squares)) / np.log(2)  # squares of noise are exponentially distributed


def waves(theta: np.ndarray, curve: np.ndarray, orders: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes and phases of orders in a curve, by least squares; phases are of cosines at input angle zero [rad].

    The mean and all orders are fitted together, so that a recording need not consist of whole turns.
    """
    columns = [np.ones(theta.shape)]
    for order in orders:
        columns += [np.cos(order * theta), np.sin(order * theta)]
    parts, *_ = np.linalg.lstsq(np.stack(columns, axis=1), curve, rcond=1e-10)
    cosine, sine = parts[1::2], parts[2::2]
    return np.hypot(cosine, sine), np.arctan2(-sine, cosine)
