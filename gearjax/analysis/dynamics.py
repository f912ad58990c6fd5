"""Dynamic transmission error: the equation of motion of the output on its contacts.

    M q'' + sum_i J_i (k_i(t) penetration(overlap_i) + c_i overlap_i') = -T(t)

(consistent form of Wang et al. 2020, eq. 19; the printed one has wrong signs). Position is scaled by 10 um on the
line of action, time by the highest natural frequency. Times come from the sample and step number.
"""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from gearjax.analysis.motion import Motion
from gearjax.analysis.quasi_static import rest
from gearjax.analysis.solvers import AdaptiveStep, FixedStep, Stepper, highest_between
from gearjax.checks import SceneError, is_concrete
from gearjax.contact import ContactSet
from gearjax.scene import Scene, require
from gearjax.typing import Array, ArrayLike, Float, Scalar

LENGTH_SCALE = 1e-5  # m on the line of action
LONGEST_STEP = 1.0  # rad of the fastest motion; Runge-Kutta is stable to 2.8
MOST_STEPS = 1_000_000_000
MOST_ROWS = 256  # steps whose excitation is tabulated at once
FAULTS = {
    1: "the solution is not finite",
    2: "the step is too long for the fastest motion (natural frequency, damping, stiffness harmonics, load)",
    3: "the adaptive solver did not finish",
    4: "there is no equilibrium to start from",
}


def simulate(
    scene: Scene,
    ts: ArrayLike,
    torque: ArrayLike,
    *,
    start: str = "equilibrium",
    settle: ArrayLike = 0.0,
    stepper: Stepper = FixedStep(),
) -> Motion:
    """Dynamic transmission error under the scene's load.

    Args:
        scene: the scene, with compliance, load and inertia.
        ts: sample times, increasing, shape (n,) [s].
        torque: size of the load torque [N m]; positive loads the driving flanks.
        start: ``"equilibrium"``, moving as the gaps move it, or ``"zero"``, at rest at the ideal position. The
            smooth static form of a smooth law is within its width of the rest position of its forces, not on it.
        settle: time after the first sample that metrics leave out [s].
        stepper: `FixedStep` or `AdaptiveStep`.

    Returns:
        The motion. While tracing, faults are in its ``result``; otherwise they raise.

    Raises:
        SceneError: the scene lacks a part, or the step does not suit it.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> motion = gj.simulate(scene, jnp.linspace(0.0, 0.1, 101), torque=100.0)
        >>> motion.te.shape, int(motion.result)
        ((101,), 0)
    """
    require(scene, "dynamic", "compliance", "load", "inertia")
    if start not in ("equilibrium", "zero"):
        raise SceneError(f'start = "{start}": valid: equilibrium, zero')
    ts = jnp.asarray(ts, dtype=scene.dtype)
    if ts.ndim != 1 or ts.shape[0] < 2:
        raise SceneError(f"ts has shape {ts.shape}: give at least two sample times")
    if is_concrete(ts) and not bool((np.diff(np.asarray(ts)) > 0).all()):
        raise SceneError("ts must increase")
    torque, settle = jnp.asarray(torque, ts.dtype), jnp.asarray(settle, ts.dtype)
    if is_concrete((ts, settle)) and not 0 <= float(settle) < float(ts[-1] - ts[0]):
        raise SceneError(f"settle = {float(settle):g} s: must be at least 0 and less than the record")
    steps = stepper.steps(ts) if isinstance(stepper, FixedStep) else 0
    physics = scene.physics("backlash", "compliance", "load", "inertia", "damping")
    motion = _simulate(physics, ts, torque, settle, start, stepper, steps)
    if is_concrete(motion.result) and int(motion.result):
        raise SceneError(f"dynamic: {FAULTS[int(motion.result)]}{_advice(scene, int(motion.result))}")
    return motion


def natural_frequency(scene: Scene) -> Scalar:
    """Highest natural frequency, all pairs in contact at their peak stiffness [rad/s]."""
    contacts = scene.contacts(jnp.zeros_like(scene.system.input_speed))
    assert scene.inertia is not None
    assert scene.compliance is not None
    lever = contacts.lever[: contacts.pairs]
    stiffness = (lever * lever).sum() * scene.compliance.peak_stiffness()
    return jnp.sqrt(stiffness / scene.inertia.moment(lever))


def fastest_rate(scene: Scene) -> Scalar:
    """Fastest rate of a scene, which a step has to resolve [rad/s].

    The largest of the highest natural frequency, the decay rate of all dampers together, the highest harmonic of the
    stiffness and the load.
    """
    assert scene.inertia is not None
    assert scene.compliance is not None
    assert scene.load is not None
    system, pairs = scene.system, scene_pairs(scene)
    orders = system.orders
    rates = [
        natural_frequency(scene),
        scene.compliance.harmonics * orders["mesh"] * system.input_speed,
        scene.load.rate(system.input_speed, orders),
    ]
    if scene.damping is not None:
        mass = scene.inertia.mass
        rates.append(scene.damping.coefficient(scene.compliance.mean_stiffness(pairs), mass).sum() / mass)
    return jnp.stack([jnp.asarray(rate, scene.dtype) for rate in rates]).max()


def suitable_step(scene: Scene, duration: float) -> FixedStep:
    """Steps that resolve the fastest motion of the scene.

    Raises:
        SceneError: the record would need more than `MOST_STEPS` steps.
    """
    step = min(4e-5, 0.4 * LONGEST_STEP / float(fastest_rate(scene)))
    if duration / step > MOST_STEPS:
        raise SceneError(
            f"run.duration = {duration:g} s needs {duration / step:.2g} steps of {step:.2g} s to follow its "
            f"fastest motion, more than {MOST_STEPS:g}: shorten it, lower compliance.mean or raise inertia.mass"
        )
    return FixedStep(step)


def _advice(scene: Scene, fault: int) -> str:
    if fault != 2:
        return ""
    longest = LONGEST_STEP / float(fastest_rate(scene))
    return f": it must be at most {longest:.3g} s, give stepper=FixedStep(step={0.25 * longest:.2g})"


class _Excitation(eqx.Module):
    """What drives the motion at one time: everything but the output's own position. Rates are ``None`` undamped."""

    lever: Array
    gap: Array
    lever_rate: Array | None
    gap_rate: Array | None
    stiffness: Array
    load: Array


class _Equation(eqx.Module):
    """The scaled equation of motion of one scene under one torque."""

    scene: Scene
    torque: Scalar
    frequency: Scalar
    scale: Scalar

    def load(self, time: Scalar) -> Scalar:
        """Load torque [N m]."""
        assert self.scene.load is not None
        turns = self.scene.system.input_speed * time / (2 * jnp.pi)
        return self.torque * self.scene.load.shape(turns, time, self.scene.system.orders)

    def _contacts(self, time: Scalar) -> ContactSet:
        return self.scene.contacts(self.scene.system.input_speed * time, "varying")

    def excitation(self, time: Scalar) -> _Excitation:
        """Contacts and load at a time [s]."""

        def gaps(time):
            contacts = self._contacts(time)
            return (contacts.lever, contacts.gap), contacts.stiffness

        if self.scene.damping is None:
            (lever, gap), stiffness = gaps(time)
            lever_rate = gap_rate = None
        else:
            (lever, gap), (lever_rate, gap_rate), stiffness = jax.jvp(
                gaps, (time,), (jnp.ones_like(time),), has_aux=True
            )
        assert stiffness is not None
        return _Excitation(lever, gap, lever_rate, gap_rate, stiffness, self.load(time))

    def forces(self, time: Scalar, position: Scalar) -> Float[Array, " contact"]:
        """Elastic force of each contact [N]."""
        now = self.excitation(time)
        return now.stiffness * self.scene.contact.penetration(now.lever * position - now.gap)

    def acceleration(self, now: _Excitation, position: Scalar, velocity: Scalar) -> Scalar:
        """Acceleration of the output's deviation [rad/s2]."""
        scene = self.scene
        assert scene.inertia is not None
        assert scene.compliance is not None
        pairs = scene_pairs(scene)
        overlap = now.lever * position - now.gap
        moment = -now.load - (now.lever * now.stiffness * scene.contact.penetration(overlap)).sum()
        if scene.damping is not None and now.lever_rate is not None and now.gap_rate is not None:
            coefficient = scene.damping.coefficient(scene.compliance.mean_stiffness(pairs), scene.inertia.mass)
            speed = (now.lever * velocity + now.lever_rate * position - now.gap_rate)[:pairs]
            engaged = scene.contact.closed(overlap)
            if overlap.shape[0] > pairs:  # one damper per pair, while either of its flanks is in contact
                engaged = 1.0 - (1.0 - engaged[:pairs]) * (1.0 - engaged[pairs:])
            moment = moment - (now.lever[:pairs] * coefficient * engaged * speed).sum()
        return moment / scene.inertia.moment(now.lever[:pairs])

    def rate(self, now: _Excitation, state: Float[Array, "2"]) -> Float[Array, "2"]:
        """Change of the scaled state per scaled time."""
        acceleration = self.acceleration(now, state[0] * self.scale, state[1] * self.scale * self.frequency)
        return jnp.stack([state[1], acceleration / (self.scale * self.frequency**2)])

    def initial(self, time: Scalar, start: str) -> Float[Array, "2"]:
        """Scaled position and velocity to start from."""
        if start == "zero":
            return jnp.zeros((2,), time.dtype)
        stiffness, load = self._contacts(time).stiffness, self.load(time)

        def follow(time: Scalar) -> Scalar:
            """Static equilibrium as the gaps move, under the stiffness and the torque of the start."""
            now = self._contacts(time)
            held = ContactSet(now.jacobian, now.gap, stiffness, now.pairs)
            return rest(held, self.scene, load).position

        position, velocity = jax.jvp(follow, (time,), (jnp.ones_like(time),))
        return jnp.stack([position, velocity / self.frequency]) / self.scale


def scene_pairs(scene: Scene) -> int:
    """Number of driving contacts of a scene."""
    return jax.eval_shape(scene.contacts, scene.system.input_speed).pairs


@eqx.filter_jit
def _simulate(
    scene: Scene, ts: Array, torque: Array, settle: Array, start: str, stepper: Stepper, steps: int
) -> Motion:
    scene = scene.anchored()
    lever = jnp.mean(jnp.abs(scene.contacts(ts[0]).lever))
    equation = _Equation(scene, torque, natural_frequency(scene), LENGTH_SCALE / lever)
    state = equation.initial(ts[0], start)
    fault = jnp.where(jnp.isfinite(state).all(), 0, 4)
    state = jnp.nan_to_num(state)
    if isinstance(stepper, AdaptiveStep):
        states, highest, lowest, failed = _adaptive(equation, ts, state, stepper)
    else:
        states, highest, lowest = _fixed(equation, ts, state, stepper, steps)
        too_long = (ts[1:] - ts[:-1]).max() / steps * fastest_rate(scene) > LONGEST_STEP
        failed = jnp.where(too_long, 2, 0)
    fault = jnp.where(fault > 0, fault, failed)
    fault = jnp.where((fault == 0) & ~jnp.isfinite(states).all(), 1, fault)
    te = states[:, 0] * equation.scale
    velocity = states[:, 1] * (equation.scale * equation.frequency)
    forces = jax.vmap(equation.forces)(ts, te)
    return Motion(
        ts, te, velocity, forces, highest * equation.scale, lowest * equation.scale, settle, fault, scene_pairs(scene)
    )


def _fixed(equation: _Equation, ts: Array, state: Array, stepper: FixedStep, steps: int):
    """Even steps: a scan over the sample intervals, cut into parts of `MOST_ROWS` steps, and over the steps of each.

    What drives the motion is tabulated for all ends and middles of the steps of an interval at once (vectorised,
    and out of the sequential loop); within a step it is interpolated, exactly so at the nodes of Runge-Kutta.
    A step runs over the time 0 to 1.
    """

    now, unpack = ravel_pytree(equation.excitation(ts[0]))

    def field(time, state, args):
        rows, span = args
        return span * equation.rate(unpack(_within(rows, time)), state)

    terms = diffrax.ODETerm(field)
    parts = -(-steps // MOST_ROWS)
    steps = -(-steps // parts)

    def interval(carry, times):
        origin, length = times
        span = length * equation.frequency / steps
        nodes = origin + jnp.arange(2 * steps + 1).astype(ts.dtype) * (0.5 / steps) * length
        table = jax.vmap(lambda time: ravel_pytree(equation.excitation(time))[0])(nodes)
        rows = jnp.stack([table[:-1:2], table[1::2], table[2::2]], axis=1)

        def step(inner, now):
            rows, first = now
            state, memory, highest, lowest = inner
            new, _, _, memory, _ = stepper.solver.step(terms, 0.0, 1.0, state, (rows, span), memory, first)
            highest = jnp.maximum(highest, highest_between(state[0], new[0], state[1], new[1], span))
            lowest = jnp.minimum(lowest, -highest_between(-state[0], -new[0], -state[1], -new[1], span))
            return (new, memory, highest, lowest), None

        state, memory = carry
        firsts = jnp.arange(steps) == 0
        start = (state, memory, state[0], state[0])
        # recompute each step when differentiating backwards: storing its inner values is slower and larger
        carry, _ = jax.lax.scan(jax.checkpoint(step, prevent_cse=False), start, (rows, firsts))
        state, memory, highest, lowest = carry
        return (state, memory), (state, highest, lowest)

    memory = stepper.solver.init(terms, 0.0, 1.0, state, (jnp.stack([now, now, now]), jnp.ones_like(ts[0])))
    lengths = (ts[1:] - ts[:-1]) / parts
    origins = ts[:-1, None] + lengths[:, None] * jnp.arange(parts).astype(ts.dtype)[None, :]
    intervals = (origins.ravel(), jnp.repeat(lengths, parts))
    _, (states, highest, lowest) = jax.lax.scan(interval, (state, memory), intervals)
    first = state[:1]
    return (
        jnp.concatenate([state[None, :], states[parts - 1 :: parts]]),
        jnp.concatenate([first, highest.reshape(-1, parts).max(axis=1)]),
        jnp.concatenate([first, lowest.reshape(-1, parts).min(axis=1)]),
    )


def _within(rows: Float[Array, "3 row"], time: float | Scalar) -> Float[Array, " row"]:
    """A row within a step, at a time from 0 to 1: the parabola through its start, middle and end."""
    if isinstance(time, float) and time in (0.0, 0.5, 1.0):
        return rows[round(2 * time)]
    weights = 2 * (time - 0.5) * (time - 1), 4 * time * (1 - time), 2 * time * (time - 0.5)
    return weights[0] * rows[0] + weights[1] * rows[1] + weights[2] * rows[2]


def _adaptive(equation: _Equation, ts: Array, state: Array, stepper: AdaptiveStep):
    """diffrax's adaptive loop; extremes are those of the samples."""

    def field(tau, state, origin):
        return equation.rate(equation.excitation(origin + tau / equation.frequency), state)

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        stepper.solver,
        t0=jnp.zeros_like(ts[0]),
        t1=(ts[-1] - ts[0]) * equation.frequency,
        dt0=jnp.full_like(ts[0], 0.05),
        y0=state,
        args=ts[0],
        saveat=diffrax.SaveAt(ts=(ts - ts[0]) * equation.frequency),
        stepsize_controller=diffrax.PIDController(rtol=stepper.rtol, atol=stepper.atol),
        max_steps=stepper.max_steps,
        adjoint=stepper.adjoint,
        throw=False,
    )
    states = jnp.asarray(solution.ys)
    failed = jnp.where(solution.result == diffrax.RESULTS.successful, 0, 3)
    return states, states[:, 0], states[:, 0], failed
