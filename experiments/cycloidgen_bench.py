"""The pin stage of an RV reducer: gearjax against cycloidgen 8, a program that designs cycloidal drives.

cycloidgen needs an environment of its own; this file runs it in a subprocess:

    python -m venv cycloidgen_env && cycloidgen_env/bin/python -m pip install cycloidgen
    python experiments/cycloidgen_bench.py --cycloidgen-python cycloidgen_env/bin/python

It takes half a minute. The disc is that of Hu et al. (2020): 40 pins of 3 mm radius on a circle of 76 mm radius, a
throw of 1.5 mm, ideal and with the modification of the paper. The two programs share no code and no reference.

Compared are, over crank angles of a mesh period:

- the outline of the disc, by the distance of cycloidgen's points from gearjax's curve,
- levers of the contacts, pin forces of equal springs and Hertzian pressures of the ideal disc,
- approach of a pin and a flank under a force (Johnson 1985), on convex and concave flanks,
- gaps of the modified disc, which cycloidgen measures between each pin and a polygon of its outline,
- backlash, which cycloidgen takes from the smallest ratio of gap to lever on each side,
- lag and largest pin force of the modified disc under a torque. cycloidgen fits ``delta = c F^0.9`` to the approach at
  the force that each pin of the ideal disc would carry, and keeps the levers of the ideal disc.

cycloidgen turns the disc the other way: its pins are those of gearjax in reverse order.
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np
from peers import agree, sized

import gearjax as gj
from gearjax.geometry.cycloid import pin_distance, trochoid
from gearjax.geometry.line_contact import Radii
from gearjax.units import arcmin, mm, um

PINS, CIRCLE, RADIUS, THROW = 40, 76.0, 3.0, 1.5  # mm
ISOMETRIC, SHIFTING = -22e-3, -43.7e-3  # mm, of the paper
YOUNGS_MODULUS, POISSONS_RATIO, FACE_WIDTH = 206.0, 0.3, 11.0  # GPa, mm
TORQUE = 392.0  # N m, half of 784 N m: one disc of two
ANGLES = 12
POINTS = 200_000  # of cycloidgen's polygon: ten times fewer are a hundred times further off

CYCLOIDGEN = r"""
import json, sys
from importlib.metadata import version
import numpy as np
from cycloidgen.analysis.mechanics import effective_modulus, hertz_line_pressure
from cycloidgen.analysis.stiffness import line_contact_approach
from cycloidgen.core import kinematics, profile

given = json.load(open(sys.argv[1]))
lobes, circle, radius, throw = given["pins"] - 1, given["circle"], given["radius"], given["throw"]
modulus, ratio, width = given["modulus"], given["ratio"], given["width"]
torque = given["torque"] * 1e3
alpha = 2 * np.pi * np.arange(given["pins"]) / given["pins"]
centres = circle * np.column_stack([np.cos(alpha), np.sin(alpha)])
steel = effective_modulus(modulus, ratio, modulus, ratio)
made = circle + given["shifting"], radius + given["isometric"], throw, lobes
polygon = profile.disc_profile(np.linspace(0, 2 * np.pi, given["points"], endpoint=False), *made)

def approach(force, flank):
    return line_contact_approach(force, width, radius, flank, modulus, ratio, modulus, ratio, reference_mm=circle)

def lagging(arms, gaps, c):
    low, high = 0.0, 1.0
    for _ in range(200):
        turn = 0.5 * (low + high)
        forces = (np.maximum(turn * arms - gaps, 0.0) / c) ** (1 / 0.9)
        low, high = (turn, high) if forces @ arms < torque else (low, turn)
    return turn, forces.max()

found = []
for phi in given["angles"]:
    state = kinematics.contacts_at(circle, radius, throw, lobes, phi)
    forces, loaded = state.forces(torque), state.loaded_mask
    curvature = profile.locus_curvature(state.t, circle, throw, lobes)
    pressure = hertz_line_pressure(forces, width, radius * (1 + radius * curvature), steel)
    gaps = profile.distance_to_polyline(kinematics.to_disc_frame(centres, phi, throw, lobes), polygon) - radius
    arms = np.abs(state.moment_arms)
    play = sum((gaps[side] / arms[side]).min() for side in (loaded, ~loaded))
    flank = -1 / state.curvature[loaded]
    c = approach(forces[loaded], flank) / forces[loaded] ** 0.9
    lag, largest = lagging(arms[loaded], gaps[loaded], c)
    found.append({"arms": state.moment_arms.tolist(), "forces": forces.tolist(), "pressure": pressure.tolist(),
                  "gaps": gaps.tolist(), "play": play, "lag": lag, "largest": largest,
                  "flank": flank.tolist(), "approach": approach(forces[loaded], flank).tolist(),
                  "pressing": forces[loaded].tolist()})
every = polygon[:: len(polygon) // 500]
json.dump({"version": version("cycloidgen"), "angles": found, "outline": every.tolist()}, open(sys.argv[2], "w"))
"""


def cycloidgen(python: str, angles: np.ndarray) -> dict[str, Any]:
    """What cycloidgen finds, in mm, N and MPa."""
    given = {
        **{"pins": PINS, "circle": CIRCLE, "radius": RADIUS, "throw": THROW},
        **{"isometric": ISOMETRIC, "shifting": SHIFTING, "points": POINTS, "torque": TORQUE},
        **{"modulus": YOUNGS_MODULUS, "ratio": POISSONS_RATIO, "width": FACE_WIDTH, "angles": angles.tolist()},
    }
    folder = Path(tempfile.mkdtemp())
    asked, answered = folder / "asked.json", folder / "answered.json"
    asked.write_text(json.dumps(given), encoding="utf-8")
    subprocess.run([python, "-c", CYCLOIDGEN, str(asked), str(answered)], check=True)
    return json.loads(answered.read_text(encoding="utf-8"))


def scene(isometric: float = 0.0, shifting: float = 0.0, compliance: Any = None, clearance: str = "exact") -> gj.Scene:
    """The pin stage in gearjax; the modification in mm."""
    system = gj.RVCycloidal(
        pins=PINS,
        pin_circle=CIRCLE * mm,
        pin_radius=RADIUS * mm,
        eccentricity=THROW * mm,
        isometric_modification=isometric * mm,
        shifting_modification=shifting * mm,
        input_speed=1.0,
        discs=1,
        clearance=clearance,
    )
    return gj.Scene(system, compliance=compliance)


def off_outline(points: np.ndarray) -> float:
    """Largest distance of points from the outline of gearjax's modified disc [m]."""
    disc = scene(ISOMETRIC, SHIFTING).system.profile
    phases = jnp.linspace(0.0, 2 * np.pi * disc.teeth, POINTS)  # once around
    x, y = trochoid(disc, phases)

    def distance(point: jax.Array) -> jax.Array:
        near = phases[jnp.argmin((x - point[0]) ** 2 + (y - point[1]) ** 2)]
        return pin_distance(disc, (point[0], point[1]), near)

    # the path of the pins' centres is a pin's radius outside of the outline, isometric modification included
    inside = jax.lax.map(distance, jnp.asarray(points * mm))
    return float(jnp.abs(inside + RADIUS * mm + ISOMETRIC * mm).max())


Row = tuple[str, float, float, str, float]


def rows(peer: dict[str, Any], angles: np.ndarray) -> list[Row]:
    """What is compared: name, largest value, largest difference, unit, and the most that may differ, over the value."""
    order = -np.arange(PINS) % PINS  # cycloidgen's pins in gearjax's order
    each = {
        name: np.array([found[name] for found in peer["angles"]]) for name in ("arms", "forces", "pressure", "gaps")
    }
    each = {name: values[:, order] for name, values in each.items()}
    one = {name: np.array([found[name] for found in peer["angles"]]) for name in ("play", "lag", "largest")}

    equal = gj.HarmonicStiffness(mean=1e8, relative_amplitudes=[], phases=[])
    # cycloidgen's levers are those of the unloaded position: so are those of "linear"
    ideal = scene(compliance=equal, clearance="linear")
    steel = gj.HertzLineContact(YOUNGS_MODULUS * 1e9, POISSONS_RATIO, FACE_WIDTH * mm)
    levers = jax.vmap(lambda angle: ideal.contacts(angle).jacobian[:, 0])(jnp.asarray(angles))
    te = gj.transmission_error(ideal, angles, TORQUE, extremes="samples")
    pressure = gj.contact_pressure(ideal, te, steel)
    assert te.forces is not None

    modified = scene(ISOMETRIC, SHIFTING, steel)
    gaps = jax.vmap(lambda angle: modified.contacts(angle).gap)(jnp.asarray(angles))
    loaded = gj.transmission_error(modified, angles, TORQUE, extremes="samples")
    assert loaded.forces is not None
    approaches = [
        (np.array(found["approach"]), approach(np.array(found["flank"]), np.array(found["pressing"]), steel))
        for found in peer["angles"]
    ]
    theirs, ours = (np.concatenate(part) for part in zip(*approaches, strict=True))

    def row(name: str, ours: Any, theirs: np.ndarray, scale: float, unit: str, most: float) -> Row:
        ours = np.asarray(ours) / scale
        return name, float(np.abs(theirs).max()), float(np.abs(ours - theirs).max()), unit, most

    return [
        ("outline of the modified disc", CIRCLE, off_outline(np.array(peer["outline"])) / mm, "mm", 1e-12),
        row("lever of a pin", levers, each["arms"], mm, "mm", 1e-11),
        row("force of a pin, equal springs", te.forces, each["forces"], 1.0, "N", 1e-11),
        row("Hertzian pressure", pressure, each["pressure"], 1e6, "MPa", 1e-6),
        row("approach of pin and flank", ours, theirs * 1e3, um, "um", 1e-3),
        row("gap of the modified disc", gaps, each["gaps"] * 1e3, um, "um", 1e-3),
        row("backlash", gj.backlash(modified, angles).backlash, one["play"] / arcmin, arcmin, "arcmin", 2e-3),
        row("lag under the torque", -loaded.te, one["lag"] / arcmin, arcmin, "arcmin", 0.01),
        row("largest force of a pin", loaded.forces.max(axis=1), one["largest"], 1.0, "N", 0.03),
    ]


def approach(flank: np.ndarray, forces: np.ndarray, steel: gj.HertzLineContact) -> np.ndarray:
    """Approach of pins and flanks by gearjax's law, from the radii of the flanks [mm], concave below zero [m]."""
    radii = Radii(jnp.full(flank.shape, RADIUS * mm), jnp.asarray(1 / (flank * mm)))
    return np.asarray(steel.springs(radii).approach(jnp.asarray(forces)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycloidgen-python", required=True, help="Python of an environment with cycloidgen")
    angles = (np.arange(ANGLES) + 0.3) * 2 * np.pi / ANGLES
    peer = cycloidgen(sized(parser).cycloidgen_python, angles)
    print(f"cycloidgen {peer['version']}, {ANGLES} crank angles, {TORQUE:g} N m on one disc\n")
    for name, largest, difference, unit, most in rows(peer, angles):
        agree(f"{name + ':':32s}{largest:12.6g} {unit:8s}difference", difference, most * largest, unit)


if __name__ == "__main__":
    main()
