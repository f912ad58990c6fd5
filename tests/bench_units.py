"""Gear sets on a test bench, written out apart from the package: an algebraic 2K-V reducer, and a pin stage whose disc
is a curve of the plane. They make recordings whose errors are known."""

import cmath
import dataclasses

import numpy as np
from scipy.integrate import odeint

import gearjax as gj
from gearjax.units import arcmin, deg, mm, um

ALPHA = 35.266 * deg
RADIUS = 62.5 * mm * np.cos(20 * deg)
RATIO = 79


@dataclasses.dataclass
class TwoKVUnit:
    """Errors as complex vectors (amplitude and phase) of planets, revolution and output wheel [m] (Wang et al. 2020,
    eqs. 1-18, errors counted as they are)."""

    planet_1: complex
    planet_2: complex
    revolution: complex
    output: complex
    stiffness: float = 1e8
    play: float = 150 * um

    def waves(self, flank: int) -> list[tuple[complex, complex, float]]:
        """Of both pairs, what turns 26 and 25 times a turn of the output, and play [m]."""
        far, play = np.exp(-1j * flank * ALPHA), 0.0 if flank > 0 else self.play
        return [
            (complex((own + sign * self.revolution) * far), complex(sign * self.output * far), play)
            for own, sign in ((self.planet_1, 1), (self.planet_2, -1))
        ]

    def edges(self, theta: np.ndarray, flank: int) -> list[np.ndarray]:
        """Positions at which both pairs touch on a flank, +1 driving [rad]."""
        spins, goes = (np.exp(1j * times * theta / RATIO) for times in (26, 25))
        return [((one * spins + other * goes).imag + play) / RADIUS for one, other, play in self.waves(flank)]

    def te(self, theta: np.ndarray, torque: float) -> np.ndarray:
        """Static TE [rad]; without torque that of the driving flanks."""
        flank = 1 if torque >= 0 else -1
        one, other = self.edges(theta, flank)
        bend = torque / (self.stiffness * RADIUS**2)
        pick = np.maximum if flank > 0 else np.minimum
        return pick(pick(one, other) - bend, (one + other - bend) / 2)

    def motion(self, theta: np.ndarray, speed: float, torque: float, mass: float, ratio: float) -> np.ndarray:
        """TE of an output of a mass on the line of action, on two dampers that act in contact, at input angles of an
        input that turns at a speed [rad]; what was before is forgotten."""
        damper = ratio * np.sqrt(2 * self.stiffness * mass)
        decay = 0.25 * damper / mass
        times, turning = theta / speed, speed / RATIO
        begin = times.min() - 20 / decay
        waves = [(flank, *wave) for flank in (1, -1) for wave in self.waves(flank)]

        def rate(time: float, state: np.ndarray) -> tuple[float, float]:
            q, velocity = state
            goes = cmath.exp(25j * turning * time)
            spins = goes * cmath.exp(1j * turning * time)
            force = -torque / RADIUS
            for flank, one, other, play in waves:
                first, second = one * spins, other * goes
                overlap = flank * ((first + second).imag + play - RADIUS * q)
                closing = flank * (turning * (26 * first + 25 * second).real - RADIUS * velocity)
                force += flank * (self.stiffness * overlap + damper * closing) if overlap > 0 else 0.0
            return velocity, force / (mass * RADIUS)

        # steps no longer than a twentieth of an oscillation miss no contact; all are taken outside Python
        longest = 0.05 * np.sqrt(mass / self.stiffness) * 2 * np.pi
        options = {"rtol": 1e-9, "atol": 1e-12, "hmax": longest, "mxstep": 1_000_000, "tfirst": True}
        start = [float(self.te(np.array([speed * begin]), torque)[0]), 0.0]
        order = np.argsort(times)
        te = np.empty(theta.shape)
        te[order] = odeint(rate, start, np.append(begin, times[order]), **options)[1:, 0]
        return te

    @property
    def told(self) -> np.ndarray:
        """What recordings tell: both sums and the output wheel [um]."""
        sums = [self.planet_1 + self.revolution, self.planet_2 - self.revolution, self.output]
        return np.array([part for value in sums for part in (value.real, value.imag)]) / um


def random_unit(seed: int, low: float = 4 * um, high: float = 22 * um) -> TwoKVUnit:
    """A unit with errors of any phase."""
    rng = np.random.default_rng(seed)
    errors = rng.uniform(low, high, 4) * np.exp(1j * rng.uniform(0, 2 * np.pi, 4))
    return TwoKVUnit(*errors, stiffness=rng.uniform(8e7, 1.2e8), play=rng.uniform(100, 180) * um)


def recorded(unit, torque: float, seed: int, *, rows=10_000, noise=0.05 * arcmin, offset=0.0, extra=None, turns=1.0):
    """A recording of a unit by encoders of 20 bits."""
    rng = np.random.default_rng(seed)
    theta = np.arange(rows) * (2 * np.pi * RATIO * turns / rows)
    theta = np.floor(theta / (2 * np.pi) * 2**20) * (2 * np.pi / 2**20)
    output = theta / RATIO + unit.te(theta, torque) + offset + noise * rng.standard_normal(rows)
    if extra is not None:
        output = output + extra(theta)
    output = np.floor(output / (2 * np.pi) * 2**20) * (2 * np.pi / 2**20)
    time = np.arange(rows) * 1.58e-3
    return gj.Measurement(theta, output, None, torque, time, f"{torque:g} N m", resolution=2 * np.pi / 2**20)


def runs(unit, seed: int, torques=(10.0, 150.0, -40.0), **options) -> list[gj.Measurement]:
    """Recordings of one unit."""
    return [recorded(unit, torque, 100 * seed + i, **options) for i, torque in enumerate(torques)]


def two_kv() -> gj.Scene:
    """The gear set of those units, with errors, stiffness and play that are not theirs."""
    scene = gj.load("configs/two_kv/wang_2020.toml")
    return dataclasses.replace(scene, reference=None, run=None)


def estimates(found: gj.Identification) -> tuple[np.ndarray, np.ndarray]:
    """Both sums, the output wheel, 1/k relative to 1e8 N/m and the play [um] with their standard errors."""
    told = found.visible.combinations
    names = ("errors.output_wheel.cos", "errors.output_wheel.sin")
    values = [each.value for each in told] + [found.estimate(name).value for name in names]
    errors = [each.error for each in told] + [found.estimate(name).error for name in names]
    stiffness, play = found.estimate("compliance.mean"), found.estimate("backlash.initial")
    values += [1e8 / stiffness.value, play.value]
    errors += [1e8 * stiffness.error / stiffness.value**2, play.error]
    return np.array(values), np.array(errors)


def truth(unit: TwoKVUnit) -> list[np.ndarray]:
    """What `estimates` should give, under both names."""
    rest = [1e8 / unit.stiffness, unit.play / um]
    one = unit.told
    other = np.concatenate([one[2:4], one[:2], -one[4:]])
    return [np.concatenate([one, rest]), np.concatenate([other, rest])]


@dataclasses.dataclass
class PinStageUnit:
    """A disc of 23 teeth among 24 pins, exact: the disc's flank is the curve at a distance from a trochoid."""

    larger: np.ndarray  # pin radii [m]
    run_out: complex  # of the disc [m]
    stiffness: float
    circle: float = 60 * mm
    radius: float = 3 * mm
    throw: float = 1.8 * mm
    isometric: float = -10 * um
    shifting: float = -32 * um

    def gaps(self, theta: np.ndarray, position: np.ndarray) -> np.ndarray:
        """Distance of each pin from the disc, shape (n, pin) [m]."""
        pins, teeth = self.larger.size, self.larger.size - 1
        places = 2 * np.pi * np.arange(pins) / pins
        turn = (-theta / teeth - position)[:, None]
        centre = (self.throw * np.exp(1j * theta))[:, None] + self.run_out * np.exp(1j * turn)
        seen = (self.circle * np.exp(1j * places)[None, :] - centre) * np.exp(-1j * turn)
        circle = self.circle + self.shifting
        v = teeth * (places[None, :] - turn)  # where the tooth of a conjugate disc would be touched
        v = teeth * np.unwrap(np.angle(seen), axis=0)  # near: the angle on the disc
        v = v + 0 * places
        best, least = v, np.abs(self._curve(v, circle) - seen)
        for shift in np.linspace(-0.7, 0.7, 57):  # the closest of some, then Newton's method
            trial = v + shift
            far = np.abs(self._curve(trial, circle) - seen)
            best, least = np.where(far < least, trial, best), np.minimum(far, least)
        v = best
        for _ in range(6):
            at, slope, bend = self._curve(v, circle), self._slope(v, circle), self._bend(v, circle)
            off = ((at - seen) * np.conj(slope)).real
            steep = np.abs(slope) ** 2 + ((at - seen) * np.conj(bend)).real
            v = v - off / np.where(np.abs(steep) > 1e-12, steep, 1.0)
        slope = self._slope(v, circle)
        away = (np.conj(-1j * slope / np.abs(slope)) * (seen - self._curve(v, circle))).real
        return away + self.radius + self.isometric - self.radius - self.larger[None, :]

    def _curve(self, v, circle):
        pins, teeth = self.larger.size, self.larger.size - 1
        return circle * np.exp(1j * v / teeth) - self.throw * np.exp(1j * v * pins / teeth)

    def _slope(self, v, circle):
        pins, teeth = self.larger.size, self.larger.size - 1
        return 1j * circle / teeth * np.exp(1j * v / teeth) - 1j * self.throw * pins / teeth * np.exp(
            1j * v * pins / teeth
        )

    def _bend(self, v, circle):
        pins, teeth = self.larger.size, self.larger.size - 1
        first, second = circle / teeth**2 * np.exp(1j * v / teeth), self.throw * (pins / teeth) ** 2
        return -first + second * np.exp(1j * v * pins / teeth)

    def te(self, theta: np.ndarray, torque: float) -> np.ndarray:
        """Static TE by virtual work, shape (n,) [rad]."""
        q, h = np.full(theta.shape, -2e-4 * np.sign(torque)), 1e-7
        for _ in range(12):
            low, high = self.gaps(theta, q - h), self.gaps(theta, q + h)
            gap, lever = 0.5 * (low + high), -(high - low) / (2 * h)
            closed = np.maximum(-gap, 0.0)
            moment = self.stiffness * (lever * closed).sum(axis=1) + torque
            slope = self.stiffness * (lever**2 * (closed > 0)).sum(axis=1)
            free = slope == 0
            step = np.where(free, np.sign(torque) * 5e-5, moment / np.where(free, 1.0, slope))
            q = q - np.clip(step, -5e-5, 5e-5)
        return q


PIN_STAGE = """
[system]
kind = "rv_cycloidal"
pins = 24
pin_circle = "60 mm"
pin_radius = "3 mm"
eccentricity = "1.8 mm"
isometric_modification = "-10 um"
shifting_modification = "-32 um"
input_speed = "300 rpm"
discs = 1
clearance = "{clearance}"
[errors.pins]
kind = "sizes"
body = "pin_ring"
larger = [{pins}]
[errors.disc]
kind = "eccentricity"
body = "disc_1"
amplitude = "1 um"
phase = "0 deg"
[compliance]
kind = "harmonic_stiffness"
mean = "1e8 N/m"
relative_amplitudes = []
phases = []
"""


def pin_stage(clearance: str = "exact") -> gj.Scene:
    """The gear set of `PinStageUnit`, without its errors."""
    return gj.loads(PIN_STAGE.format(clearance=clearance, pins=", ".join(['"0 um"'] * 24)))


def pin_stage_runs(
    unit: PinStageUnit,
    seed: int,
    torques=(60.0, 300.0, -60.0),
    noise=0.02 * arcmin,
    drift=0.0,
    per_turn=60,
    counts=None,
) -> list[gj.Measurement]:
    """Recordings of one turn of the output, some rows a turn of the crank."""
    rng = np.random.default_rng(seed)
    theta = np.arange(23 * per_turn) * (2 * np.pi / per_turn)
    records = []
    offsets = drift * rng.standard_normal(len(torques))
    for torque, offset in zip(torques, offsets, strict=True):
        output = theta / 23 + unit.te(theta, torque) + offset + noise * rng.standard_normal(theta.size)
        if counts is not None:  # of the encoder at the output, per turn
            output = np.floor(output / (2 * np.pi) * counts) * (2 * np.pi / counts)
        records.append(gj.Measurement(theta, output, None, torque, theta / 31.4, f"{torque:g} N m"))
    return records
