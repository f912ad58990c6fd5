"""The equation of motion for even steps: an oscillator whose springs and dampers act only while contacts are closed."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis.equation import Equation, Instant, mesh_angles
from gearjax.analysis.fast.fitted import State
from gearjax.contact import HardContact
from gearjax.contact.layout import Place
from gearjax.typing import Array, Float, Scalar

FEW = 8  # largest number of pairs that are written out one by one


Numbers = Array | tuple[Array, ...]  # a tuple of separate numbers if motions run in parallel


class Slow(NamedTuple):
    """Slow part of the excitation of a step, which follows the rotation of the bodies.

    Args:
        lever: change of overlap per scaled position, shape (contact,) [m].
        gap: gaps, shape (contact,) [m].
        inverse: push per force and lever, shape () [1/N m].
        damping: ``d h / 2`` of a damper along each flank that may have one, shape (damper,): of all contacts if dampers
            act in contact, of the first flanks if they always act.
        decay: ``e^-damping``, shape (damper,).
        drag: push of such a damper on an output at rest, shape (damper,).
        turning: drag per scaled position, shape (damper,); ``None`` if the levers are constant or without dampers.
        accelerating: torque that accelerates the ideal output [N m]; ``None`` if it turns evenly.
        phase: mesh phase of each pair, shape (pair,) [rad]; ``None`` if it grows evenly, or if stiffness is constant.
    """

    lever: Numbers
    gap: Numbers
    inverse: Array
    damping: Numbers
    decay: Numbers
    drag: Numbers
    turning: Numbers | None
    accelerating: Array | None
    phase: Numbers | None

    def balanced(self, torque: Array) -> Array:
        """Torque that contacts balance under a load, both in N m."""
        return torque if self.accelerating is None else torque + self.accelerating


class Fast(NamedTuple):
    """Fast part of the excitation of a step, which follows the teeth or the load.

    It is the stiffness of one contact of each pair [N/m], and the load torque less what impacts carry [N m].
    """

    stiffness: Numbers
    torque: Array


class Oscillator(eqx.Module):
    """The equation of motion for even steps.

    Args:
        equation: equation of motion.
        step: length of a step [s].
    """

    equation: Equation
    step: Scalar

    def slow_at(self, time: Scalar) -> Slow:
        """Slow excitation of the step at a time [s]."""
        return self.slow(self.equation.instant(time))

    def slow(self, instant: Instant) -> Slow:
        """Slow excitation of the step at an instant."""
        scene, now, scale = self.equation.scene, self.equation.gaps(instant), self.equation.scale
        layout, inertia = self.equation.layout, self.equation.inertia
        inverse = self.step * self.step / (inertia * scale * scale)
        damping = drag = jnp.zeros((layout.teeth,), now.gap.dtype)
        turning = None
        if scene.damping is not None:
            assert now.gap_rate is not None
            mean = scene.linear_compliance.mean_stiffness(layout.teeth)
            coefficient, along = scene.damping.coefficient(mean, self.equation.mass), layout.flanks[0]
            if scene.damping.acting == "contact":
                coefficient, along = layout.per_contact(coefficient), slice(None)
            arm = now.lever[along]
            damping = 0.5 * self.step * coefficient * arm * arm / inertia
            drag = inverse * scale * coefficient * arm * now.gap_rate[along]
            if now.lever_rate is not None:
                turning = -inverse * scale * scale * coefficient * arm * now.lever_rate[along]
        accelerating = self.equation.accelerating_at(instant.time)
        phase = mesh_phases(self.equation, instant.time) if self.equation.meshes_unevenly else None
        decay = jnp.exp(-damping)
        return Slow(now.lever * scale, now.gap, inverse, damping, decay, drag, turning, accelerating, phase)

    def state(self, slow: Slow, fast: Fast, position: Array) -> State:
        """The oscillator of the contacts that are closed at a position."""
        scene, layout = self.equation.scene, self.equation.layout
        hard = isinstance(scene.contact, HardContact)
        nothing = jnp.zeros_like(position)
        force, stiffness, drag, damping, decay = [], [], [], [], []
        always = scene.damping is not None and scene.damping.acting == "always"
        together: list[tuple[Place, tuple[Place, ...]]] = [(slice(0, layout.teeth), layout.flanks)]
        for pair, flanks in enumerate(layout.members) if layout.teeth <= FEW else together:
            acting: list[tuple[Array, Place]] = []  # dampers along flanks, with how far each flank is closed
            for flank in flanks:
                lever, gap = _part(slow.lever, flank), _part(slow.gap, flank)
                overlap = lever * position - gap
                spring = lever * (slow.inverse * _part(fast.stiffness, pair))
                # hard contacts select: in a batch this takes half the time of products with zeros and ones
                closed = overlap > 0 if hard else scene.contact.closed(overlap)
                force.append(_gate(closed, spring * overlap) if hard else spring * scene.contact.penetration(overlap))
                stiffness.append(_gate(closed, spring * lever))
                acting.append((closed, flank))
            if scene.damping is None:
                continue
            if always:
                acting = [(jnp.ones_like(acting[0][0]), pair)]
            pull, damped, left = nothing, nothing, jnp.ones_like(position)
            for closed, flank in reversed(acting):  # the first flank that touches has the damper
                own = _part(slow.drag, flank)
                own = own if slow.turning is None else own + _part(slow.turning, flank) * position
                pull, damped = _choose(closed, own, pull), _choose(closed, _part(slow.damping, flank), damped)
                left = jnp.where(closed, _part(slow.decay, flank), left) if hard else left
            drag.append(pull)
            damping.append(damped)
            if hard:
                decay.append(left.prod())
        held = slow.inverse * self.equation.scale * slow.balanced(fast.torque)
        push = _total(drag, nothing) - _total(force, nothing) - held
        damped = _total(damping, nothing)
        left = jnp.exp(-damped) if not hard else jnp.ones_like(position)
        for part in decay:
            left = left * part
        return State(push, _total(stiffness, nothing), damped, left)

    def resting(self, slow: Slow, fast: Fast) -> Scalar:
        """Scaled position of the static equilibrium."""
        lever, gap, stiffness = self._springs(slow, fast)
        scale = self.equation.scale
        return self.equation.equilibrium(lever / scale, gap, stiffness, slow.balanced(fast.torque)) / scale

    def _springs(self, slow: Slow, fast: Fast) -> tuple[Array, Array, Array]:
        """Lever per scaled position, gap and stiffness of each contact."""
        springs = tuple(fast.stiffness[pair] for pair in self.equation.layout.pair)
        lever, gap, stiffness = (jnp.stack(part) for part in (slow.lever, slow.gap, springs))
        return lever, gap, stiffness

    def forces(self, slow: Slow, fast: Fast, position: Array) -> Float[Array, " contact"]:
        """Elastic force of each contact [N]."""
        lever, gap, stiffness = self._springs(slow, fast)
        return stiffness * self.equation.scene.contact.penetration(lever * position - gap)


def _part(numbers: Numbers, place: Place) -> Array:
    """Numbers at one place, or at several together."""
    if not isinstance(numbers, tuple):
        return numbers[place]
    if isinstance(place, np.ndarray):
        return jnp.stack([numbers[index] for index in place])
    part = numbers[place]
    return jnp.stack(part) if isinstance(part, tuple) else part


def _gate(closed: Array, value: Array) -> Array:
    """The value for closed contacts, otherwise zero; with a smooth law in proportion to how far contacts are closed."""
    return jnp.where(closed, value, 0.0) if closed.dtype == bool else closed * value


def _choose(closed: Array, value: Array, other: Array) -> Array:
    """The value for closed contacts, otherwise the other one; with a smooth law a mean of both."""
    return jnp.where(closed, value, other) if closed.dtype == bool else other + closed * (value - other)


def _total(parts: list[Array], nothing: Array) -> Array:
    """Sum of numbers, added as a tree; in a chain each addition would wait for the one before."""
    parts = [part.sum() for part in parts] or [nothing]
    while len(parts) > 1:
        parts = [sum(parts[i + 1 : i + 2], parts[i]) for i in range(0, len(parts), 2)]
    return parts[0]


class Harmonics(NamedTuple):
    """Stiffness of a contact of each pair as a Fourier series of its mesh phase.

    Args:
        mean: mean stiffness, shape (pair,) [N/m].
        cosine, sine: coefficients, shape (harmonic, pair) [N/m].
    """

    mean: Array
    cosine: Array
    sine: Array

    @classmethod
    def of(cls, equation: Equation) -> "Harmonics":
        """The series of a scene, from as many samples per mesh period as it has terms."""
        compliance, pairs = equation.scene.linear_compliance, equation.layout.teeth
        number = 2 * compliance.harmonics + 1
        angles = 2 * np.pi * np.arange(number) / number
        dtype = equation.scene.dtype
        of_pairs = jnp.stack([compliance.stiffness(jnp.full((pairs,), angle, dtype)) for angle in angles])
        sampled = equation.layout.apiece(of_pairs)
        order = np.arange(1, compliance.harmonics + 1)[:, None] * angles[None, :]
        waves = [jnp.asarray(2 / number * wave, dtype) for wave in (np.cos(order), np.sin(order))]
        cosine, sine = ((wave[:, :, None] * sampled[None, :, :]).sum(axis=1) for wave in waves)
        return cls(sampled.mean(axis=0), cosine, sine)

    def turned(self, angle: Float[Array, " pair"]) -> "Harmonics":
        """The series shifted, so that it counts from the given mesh phase [rad]."""
        if self.cosine.shape[0] == 0:
            return self
        order = jnp.arange(1, self.cosine.shape[0] + 1).astype(angle.dtype)
        turn = order[:, None] * angle[None, :]
        cosine, sine = jnp.cos(turn), jnp.sin(turn)
        return Harmonics(self.mean, self.cosine * cosine + self.sine * sine, self.sine * cosine - self.cosine * sine)

    def at(self, phase: Float[Array, " pair"]) -> Float[Array, " pair"]:
        """Stiffness of a contact of each pair at its mesh phase [N/m]."""
        c, s = jnp.cos(phase), jnp.sin(phase)
        whole, wave, other = self.mean, jnp.ones_like(c), jnp.zeros_like(c)
        for cosine, sine in zip(self.cosine, self.sine, strict=True):
            wave, other = wave * c - other * s, other * c + wave * s  # the harmonic before, turned by the phase
            whole = whole + cosine * wave + sine * other
        return whole


def mesh_phases(equation: Equation, time: Scalar) -> Float[Array, " pair"]:
    """Mesh phase of each pair at a time [s]."""
    return mesh_angles(equation.scene, equation.scene.system.input_speed * time)


def mesh_rate(equation: Equation) -> Scalar:
    """Rate of the mesh phase [rad/s]."""
    start = jnp.zeros_like(equation.scene.system.input_speed)
    return jax.jvp(lambda time: mesh_phases(equation, time), (start,), (jnp.ones_like(start),))[1].mean()
