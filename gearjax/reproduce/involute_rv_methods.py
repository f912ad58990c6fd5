"""The methods of Yang, Tang and Liang (2019): two-dimensional, eqs. (9), (10), and linear programme, eqs. (3), (4)."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.compliance import ElasticTeeth
from gearjax.contact import Places
from gearjax.contact.coupled import coupled_balance
from gearjax.geometry.internal_pair import InternalPair, candidate_rolls
from gearjax.reproduce import involute_rv_pair as own
from gearjax.typing import Array
from gearjax.units import um

LENGTH = 1e-8  # m, unit of length of the programme, so that numbers are far above the tolerances of its solver
EARLY = 3 * um  # largest gap of points in the first programme: all points take longer, too few do not converge
EXACT = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
MOST_PROGRAMMES = 20
SETTLED = 1e-9  # smaller numbers of a programme count as zero


class Pressed(NamedTuple):
    """Forces of points that carry a load together.

    Args:
        forces: forces at the points, shape (point,) [N].
        approach: approach of the gears along the line of action, ``r_b1 theta`` [m].
    """

    forces: np.ndarray
    approach: float


_balance = jax.jit(coupled_balance)


def pressed(influence: np.ndarray, gap: np.ndarray) -> Pressed:
    """Solve the contact of the points under the torque by the package's solver.

    The problem is eqs. (5) and (8), with forces and openings that are not negative.

    Args:
        influence: approach of each point per force on each point, shape (point, point) [m/N].
        gap: initial clearance, shape (point,) [m].
    """
    radius = own.pair().base_radii[0]
    position, forces, result = _balance(influence, jnp.full(len(gap), radius), jnp.asarray(gap), own.TORQUE)
    assert int(result) == 0
    return Pressed(np.asarray(forces), float(position * radius))


class _Programme(NamedTuple):
    """Solution of a linear programme (4).

    Args:
        values: force of each point that may carry [N], slack of the others [0.01 um], shape (point,).
        approach: delta [0.01 um].
        objective: sum of the artificial variables, eq. (3) [0.01 um] and [N].
        entering: change of the objective per unit of the variable (force or slack) that a point does not have in this
            programme, shape (point,).
    """

    values: np.ndarray
    approach: float
    objective: float
    entering: np.ndarray


def by_programme(influence: np.ndarray, gap: np.ndarray, force: float) -> Pressed:
    """Solve the same contact by the paper's linear programme, with another solver, HiGHS.

    At each point either the force or the slack must be zero. This complementarity condition is not linear. Conry and
    Seireg (1971) let a variable enter the basis only if the condition stays satisfied. Here each programme has only one
    of the two variables for each point. A point changes to the other variable if its variable is zero and the other one
    would lower the objective. This is repeated until no point changes; the objective must be zero then.

    Args:
        influence: approach of each point per force on each point, shape (point, point) [m/N].
        gap: initial clearance, shape (point,) [m].
        force: sum of the forces of all points [N].
    """
    scaled, clearance = influence / LENGTH, gap / LENGTH
    carry = gap <= max(EARLY, float(gap.min()))
    programme = _programme(scaled, clearance, force, carry)
    for _ in range(MOST_PROGRAMMES):
        change = (programme.values <= SETTLED) & (programme.entering < -SETTLED)
        if not change.any():
            break
        carry = carry ^ change
        programme = _programme(scaled, clearance, force, carry)
    assert programme.objective < 1e-6, "the artificial variables of eq. (4) have not left the basis"
    return Pressed(np.where(carry, programme.values, 0.0), programme.approach * LENGTH)


def _programme(influence: np.ndarray, gap: np.ndarray, force: float, carry: np.ndarray) -> _Programme:
    """Solve eqs. (3) and (4) with a force as variable at the points in ``carry``, and a slack at the others.

    The artificial variables are the residuals of the equations, ``gap + S F - delta - Y >= 0`` and
    ``P - sum F >= 0``. The programme has inequalities in place of these variables, and its objective is their sum.
    """
    from scipy.optimize import linprog  # the import takes a tenth of a second and only this function needs it

    number = len(gap)
    forces = np.vstack([-influence, np.ones(number)])
    slacks = np.vstack([np.eye(number), np.zeros(number)])
    columns, others = np.where(carry, forces, slacks), np.where(carry, slacks, forces)
    matrix = np.hstack([columns, np.append(np.ones(number), 0.0)[:, None]])
    right = np.append(gap, force)
    solution = linprog(-matrix.sum(axis=0), A_ub=matrix, b_ub=right, method="highs-ds", options=EXACT)
    assert solution.success, solution.message
    entering = -others.sum(axis=0) - solution.ineqlin.marginals @ others
    return _Programme(solution.x[:-1], float(solution.x[-1]), float(solution.fun + right.sum()), entering)


class PairStiffness(NamedTuple):
    """Data of each pair of teeth for eqs. (9) and (10), shape (pair,) each.

    Args:
        tooth: number of the pair in the paper.
        clearance: smallest clearance over the flanks of the pair, ``r_b1 phi`` [m].
        stiffness: stiffness of the pair, ``B k`` [N/m].
    """

    tooth: np.ndarray
    clearance: np.ndarray
    stiffness: np.ndarray


def pair_stiffness() -> PairStiffness:
    """Stiffness of the pairs by beams, foundation and contact, for the paper's "material mechanics method".

    Each pair touches where its gap is smallest (`ElasticTeeth` with one candidate, on a half-plane, after Weber and
    Banaschek 1953).
    """
    tooth, roll = own.rolls()
    clearance, yielding = _pairs(own.pair(), jnp.asarray(roll))
    return PairStiffness(tooth, np.asarray(clearance), 1 / np.asarray(yielding))


@eqx.filter_jit
def _pairs(both: InternalPair, roll: Array) -> tuple[Array, Array]:
    """Clearance [m] and approach per force [m/N] of each pair."""
    begin, end = both.ends(roll)
    points = both.points(roll[:, None], candidate_rolls(begin, end, 1))
    radii = both.external.radius_at(points.roll[0])[None], both.internal.radius_at(points.roll[1])[None]
    shared = 0.5 * both.base_radii[0] * ((roll + end) ** 2 - (roll + begin) ** 2)
    none = jnp.zeros_like(shared)  # teeth do not matter: only the influence of a pair on itself is used
    places = Places((both.external, both.internal), radii, none[None], shared[None], jnp.zeros(1))
    steel = own.YOUNGS_MODULUS, own.POISSONS_RATIO
    teeth = ElasticTeeth(*steel, own.EXTERNAL_WIDTH, own.INTERNAL_WIDTH)
    return points.gap[:, 0], jnp.diagonal(teeth.influence(places))


def two_dimensional(pairs: PairStiffness, force: float) -> np.ndarray:
    """Loads of the pairs by eq. (9), shape (pair,) [N].

    Pairs are added in the order of their clearances, as long as no load becomes negative. The last row of the printed
    matrix lacks a minus sign.

    Args:
        pairs: clearances and stiffness.
        force: sum of the loads of all pairs, ``T / r_b`` [N].
    """
    order = np.argsort(pairs.clearance)
    loads = np.zeros(len(order))
    for number in range(1, len(order) + 1):
        chosen = order[:number]
        yielding, steps = 1 / pairs.stiffness[chosen], np.arange(number - 1)
        matrix = np.zeros((number, number))
        matrix[0] = 1.0
        matrix[steps + 1, steps], matrix[steps + 1, steps + 1] = yielding[:-1], -yielding[1:]
        chosen_loads = np.linalg.solve(matrix, np.append(force, np.diff(pairs.clearance[chosen])))
        if (chosen_loads < 0).any():
            break
        loads[:] = 0.0
        loads[chosen] = chosen_loads
    return loads
