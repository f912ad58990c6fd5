"""Helical pair of Guo and Fang (2018): a design search, motion of slices, and speeds side by side, beside peers.

Designs: peak-to-peak static TE of micro-geometries (two reliefs, crowning) at five torques and 64 angles of a mesh; the
peer is numpy, by sorted contacts, all angles and torques of a design at once. Motion: slices at 2,104 rpm over some
meshes, against DOP853 of scipy at a tolerance that gives the same error, and our own Runge-Kutta steps of the same
error. Speeds: the periodic motion at 200 of them in one batch, of slices and as one contact. Hunting period: 893 meshes
with run-out of both gears, as one contact of 5,358 harmonics; harmonic balance against our own even steps and DOP853.
Tasks take turns, times are medians after compilation.

    python experiments/helical_bench.py [--designs 1000] [--repeats 5]

The stated targets are of one core: ``taskset -c 0`` before it.
"""

import argparse
import dataclasses
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from peers import agree, interleaved, sized
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

import gearjax as gj
from gearjax.units import arcmin, rpm, um

CONFIG = Path(__file__).parents[1] / "configs" / "helical" / "guo_2018.toml"
TORQUES, ANGLES = np.array([100.0, 200.0, 400.0, 600.0, 830.0]), 64
SPEED, EACH = 2104 * rpm, 64
SLOWEST, FASTEST = 200 * rpm, 12000 * rpm
TORQUE, AT_ONCE = 830.0, 10
HUNTING, SETTLED = 893, 64  # meshes of a hunting period, and those that a start takes to die out


def pair() -> gj.Scene:
    """The pair, with what repeats with the mesh and what its motion needs."""
    scene = gj.load(CONFIG)
    errors = {name: scene.errors[name] for name in ("tip", "root", "crowning")}
    parts = {"inertia": gj.MomentOfInertia(0.0587), "damping": gj.DampingRatio(0.07)}
    system = dataclasses.replace(scene.system, input_speed=SPEED)
    return dataclasses.replace(scene, errors=errors, system=system, run=None, **parts)


def modified(scene: gj.Scene, numbers: jax.Array) -> gj.Scene:
    """The pair with other reliefs and crowning."""
    errors = scene.errors
    changed = {
        name: dataclasses.replace(errors[name], amount=numbers[place][None])
        for place, name in enumerate(("tip", "root", "crowning"))
    }
    return dataclasses.replace(scene, errors=changed)


class Designs:
    """Micro-geometries, ours and by numpy."""

    def __init__(self, scene: gj.Scene, number: int):
        self.theta = np.arange(ANGLES) * 2 * np.pi / (scene.system.pinion_teeth * ANGLES)
        self.numbers = np.random.default_rng(0).uniform(0.0, 20 * um, (number, 3))

        def swings(numbers: jax.Array) -> jax.Array:
            own = modified(scene, numbers)

            def swing(torque: jax.Array) -> jax.Array:
                te = gj.transmission_error(own, self.theta, torque=torque, extremes="samples")
                return te.peak_to_peak

            return jax.vmap(swing)(jnp.asarray(TORQUES))

        self._swings = jax.jit(lambda rows: jax.lax.map(swings, rows, batch_size=AT_ONCE))
        contacts = jax.vmap(lambda angle: modified(scene, jnp.zeros(3)).contacts(angle, "mean"))(self.theta)
        self.plain, self.stiffness = (np.asarray(part) for part in (contacts.gap, contacts.linear))
        self.lever = float(contacts.jacobian[0, 0, 0])
        unit = [modified(scene, jnp.eye(3)[place] * um) for place in range(3)]
        gaps = [jax.vmap(lambda angle, own=own: own.contacts(angle, "mean").gap)(self.theta) for own in unit]
        self.shapes = [(np.asarray(gap) - self.plain) / um for gap in gaps]

    def ours(self) -> jax.Array:
        """Peak-to-peak of each design and torque [rad]."""
        return self._swings(jnp.asarray(self.numbers))

    def by_numpy(self) -> np.ndarray:
        """The same by sorted contacts: the position lies where the force of those that it passes is the torque."""
        size, found = abs(self.lever), []
        for numbers in self.numbers:
            gap = self.plain + sum(amount * shape for amount, shape in zip(numbers, self.shapes, strict=True))
            order = np.argsort(gap, axis=1)
            gap, stiffness = (np.take_along_axis(part, order, axis=1) for part in (gap, self.stiffness))
            springs, moments = np.cumsum(stiffness, axis=1), np.cumsum(stiffness * gap, axis=1)
            at_next = gap[:, 1:] * springs[:, :-1] - moments[:, :-1]  # force as the next one touches
            for torque in TORQUES:
                last = (at_next < torque / size).sum(axis=1)[:, None]
                whole, moment = (np.take_along_axis(part, last, axis=1)[:, 0] for part in (springs, moments))
                found.append(np.ptp((torque / size + moment) / whole / size))
        return np.array(found).reshape(-1, len(TORQUES))


class Motion:
    """Slices in motion, from the same start."""

    def __init__(self, scene: gj.Scene, meshes: int):
        self.scene, self.period = scene, 2 * np.pi / (scene.system.pinion_teeth * float(SPEED))
        self.ts = np.linspace(0.0, meshes * self.period, meshes * EACH + 1)
        self.step = gj.chosen_steps(scene, self.ts, TORQUE).step
        first = self.ours()
        self.start = [float(first.te[0]), float(first.velocity[0])]
        self.exact = self.by_steps(16).te

    def ours(self) -> gj.Motion:
        return gj.simulate(self.scene, self.ts, TORQUE)

    def by_steps(self, shorter: float) -> gj.Motion:
        stepper = gj.FixedStep(step=self.step / shorter, solver=gj.RungeKutta4())
        return gj.simulate(self.scene, self.ts, TORQUE, stepper=stepper)

    def by_scipy(self) -> np.ndarray:
        """DOP853 on the plain equation of motion, each evaluation a compiled one."""
        from gearjax.analysis.modes import StructureEquation

        equation = jax.jit(lambda: StructureEquation.of(self.scene, jnp.asarray(TORQUE)))()
        pull = jax.jit(lambda time, state: equation.acceleration(equation.excitation(time), state[:1], state[1:])[0])

        def field(time: float, state: np.ndarray) -> list[float]:
            return [state[1], float(pull(time, state))]

        span = 0.0, self.ts[-1]
        found = solve_ivp(field, span, self.start, "DOP853", self.ts, rtol=1e-5, atol=1e-10, max_step=self.period / 8)
        return found.y[0]

    def off(self, te: np.ndarray | jax.Array) -> float:
        """Largest error [arcmin]."""
        return float(np.abs(np.asarray(te) - self.exact).max()) / arcmin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options = sized(parser, designs=(1000, 10), repeats=(5, 1), speeds=(200, 0), meshes=(16, 1), hunted=(893, 19))
    scene = pair()
    designs = Designs(scene, options.designs)
    tasks = {"gearjax": designs.ours, "numpy": designs.by_numpy}
    results, first, seconds = interleaved(tasks, options.repeats, slow=1.0)
    apart = np.abs(np.asarray(results["gearjax"]) - results["numpy"]).max() / results["numpy"].max()
    print(f"{options.designs} designs x {len(TORQUES)} torques x {ANGLES} angles, {designs.plain.shape[1]} slices")
    for name, spent in seconds.items():
        print(f"  {name:24s} {spent:8.3f} s (first call {first[name]:.1f} s)")
    held = "held" if seconds["gearjax"] * 1000 / options.designs <= 2 else "NOT HELD"
    agree("  largest difference over the largest swing", apart, 1e-9)
    print(f"  1,000 designs in 2 s: {held}", flush=True)

    motion = Motion(scene, options.meshes)
    tasks = {
        "constant modes": motion.ours,
        "Runge-Kutta, same steps": lambda: motion.by_steps(1),
        "scipy": motion.by_scipy,
    }
    results, first, seconds = interleaved(tasks, options.repeats, slow=1.0)
    print(f"{options.meshes} meshes of slices at 2,104 rpm, {motion.period / motion.step:.0f} steps each")
    for name, spent in seconds.items():
        te = results[name] if name == "scipy" else results[name].te
        print(f"  {name:24s} {spent:8.4f} s (first call {first[name]:.1f} s)")
        agree("    largest error", motion.off(te), 1e-3, "arcmin")
    if options.speeds:
        waterfalls(scene, options)
    hunting(options)


def waterfalls(scene: gj.Scene, options: argparse.Namespace) -> None:
    """Amplitudes over speeds, by shooting; the short form leaves them out, as no other program is beside them."""
    speeds = np.linspace(SLOWEST, FASTEST, options.speeds)
    one = gj.one_contact(scene, TORQUE).scene
    tasks = {
        "one contact": lambda: gj.waterfall(one, TORQUE, speeds),
        "slices": lambda: gj.waterfall(scene, TORQUE, speeds),
    }
    results, first, seconds = interleaved(tasks, options.repeats, slow=60.0)
    print(f"{len(speeds)} speeds, shooting, 128 steps a mesh")
    for name, spent in seconds.items():
        lost = int((np.asarray(results[name].result) != 0).sum())
        print(f"  {name:24s} {spent:8.3f} s (first call {first[name]:.1f} s), {lost} not found")


class Hunting:
    """The pair with run-out of its gears as one contact over a period, 6 harmonics to each mesh."""

    def __init__(self, meshes: int):
        errors = dict(gj.load(CONFIG).errors)
        if meshes != HUNTING:  # a turn of the pinion, whose run-out alone repeats
            del errors["wheel"]
        scene = dataclasses.replace(pair(), errors=errors)
        angle, self.meshes = meshes * 2 * np.pi / scene.system.pinion_teeth, meshes
        self.scene = gj.one_contact(scene, TORQUE, period=angle, samples=16 * meshes, harmonics=6 * meshes).scene
        self.period, self.lever = angle / float(SPEED), float(self.scene.system.lever)
        self.ts = np.arange((meshes + SETTLED) * 16) * self.period / meshes / 16
        self.exact = self.balanced(36, 96)

    def balanced(self, harmonics: int, samples: int) -> np.ndarray:
        """Displacement along the line of action, 16 samples a mesh, by harmonic balance [m]."""
        found = gj.harmonic_balance(
            self.scene,
            TORQUE,
            self.period,
            harmonics=harmonics * self.meshes - 1,
            samples=samples * self.meshes,
        )
        if int(found.result):
            raise SystemExit("harmonic balance did not converge")
        return np.asarray(found.te)[:: samples // 16] * self.lever

    def by_steps(self, each: int) -> np.ndarray:
        """The same by even steps, after as many meshes as the start takes to die out."""
        stepper = gj.FixedStep(per_sample=each // 16)
        te = np.asarray(gj.simulate(self.scene, self.ts, TORQUE, stepper=stepper).te) * self.lever
        return np.roll(te[SETTLED * 16 :], SETTLED * 16)

    def by_scipy(self) -> np.ndarray:
        """The same by DOP853 on splines of stiffness and gap."""
        system, springs = self.scene.system, self.scene.compliance
        each = 64 * self.meshes
        phase = 2 * np.pi * np.arange(each + 1) / each
        time = phase / (2 * np.pi) * self.period
        stiffness, gap = (
            make_interp_spline(time, np.append(wave[:-1], wave[0]), k=5, bc_type="periodic")
            for wave in (np.asarray(part.at(jnp.asarray(phase))) for part in (springs.waves, system.gaps[0]))
        )
        rate = gap.derivative()
        mass = float(self.scene.inertia.moment_of_inertia) / self.lever**2
        damping = float(self.scene.damping.ratio) * np.sqrt(2 * float(springs.waves.mean) * mass)

        def field(time: float, state: np.ndarray) -> list[float]:
            at = time % self.period
            overlap = -state[0] - gap(at)
            force = stiffness(at) * overlap + damping * (-state[1] - rate(at)) if overlap > 0 else 0.0
            return [state[1], (force - TORQUE / self.lever) / mass]

        start = [self.exact[0], 0.0]
        found = solve_ivp(field, (0.0, self.ts[-1]), start, "DOP853", self.ts, rtol=1e-8, atol=1e-12)
        return np.roll(found.y[0][SETTLED * 16 :], SETTLED * 16)


def hunting(options: argparse.Namespace) -> None:
    """The periodic motion over all meshes of a hunting period."""
    period = Hunting(options.hunted)
    tasks = {
        "harmonic balance, 12 a mesh": lambda: period.balanced(12, 32),
        "harmonic balance, 16 a mesh": lambda: period.balanced(16, 32),
        "harmonic balance, 20 a mesh": lambda: period.balanced(20, 48),
        "even steps, 192 a mesh": lambda: period.by_steps(192),
        "even steps, 1024 a mesh": lambda: period.by_steps(1024),
        "even steps, 6144 a mesh": lambda: period.by_steps(6144),
        "scipy": period.by_scipy,
    }
    results, first, seconds = interleaved(tasks, options.repeats, slow=1.0)
    print(f"hunting period, {options.hunted} meshes, as one contact")
    for name, spent in seconds.items():
        print(f"  {name:28s} {spent:8.3f} s (first call {first[name]:.1f} s)")
        agree("    largest error", float(np.abs(results[name] - period.exact).max()) / um, 1e-3, "um")


if __name__ == "__main__":
    main()
