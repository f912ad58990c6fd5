"""Drawings of involute pairs: teeth of both gears near the contacts, candidates, gaps and contact forces."""

import math
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gearjax.analysis.resting import edge, edges
from gearjax.geometry.involute import InvoluteGear
from gearjax.plot.axes import gear_set_of, save_figure
from gearjax.scene import Scene
from gearjax.systems import InvoluteRV
from gearjax.typing import ArrayLike, Scalar
from gearjax.units import mm, um

POINTS = 24  # points of a flank
WIDEST_GAP = 0.35  # modules: size of the largest gap in the drawing; a wider one would reach the next tooth
LONGEST_ARROW = 2.2  # modules
RIM = 0.5  # modules of material under the roots
BESIDE = 1  # pairs shown on either side of those that carry
FEWEST = 5  # smallest number of pairs shown


class Zone(NamedTuple):
    """Candidates of one flank of one external gear, in axes of its throw, as if they were driving flanks.

    Args:
        tooth: number of each pair on the external gear, shape (pair,).
        place: positions of the candidates on the external flank and on the ring's, shape (gear, pair, point) [m],
            complex.
        normal: normal of the ring's flank, out of the external tooth, shape (pair, point), complex.
        gap: gaps before the torque acts, shape (pair, point) [m].
        force: contact forces, shape (pair, point) [N].
    """

    tooth: np.ndarray
    place: np.ndarray
    normal: np.ndarray
    gap: np.ndarray
    force: np.ndarray

    def only(self, shown: np.ndarray) -> "Zone":
        """Some of the pairs, in order of their position around the ring."""
        shown = shown[np.argsort(np.angle(self.place[1, shown, 0]))]
        return Zone(self.tooth[shown], self.place[:, shown], self.normal[shown], self.gap[shown], self.force[shown])

    @property
    def loads(self) -> np.ndarray:
        """Load of each pair, shape (pair,) [N]."""
        return self.force.sum(axis=1)


def pair_figure(scene: Scene, theta: float, forces: ArrayLike) -> Figure:
    """Draw the teeth of each external gear in the ring near the pairs that carry, and the load of every pair.

    The circumference is laid out straight. The gaps are those before the torque acts, when the first flank of the
    loaded side just touches; they are enlarged by a factor that the title states. If back flanks carry, the drawing is
    mirrored.

    Args:
        scene: scene with an `InvoluteRV`.
        theta: input angle [rad].
        forces: contact forces under a torque, shape (contact,) [N].

    Raises:
        SceneError: the scene has another gear set.
    """
    system = gear_set_of(scene.system, "an involute_rv", InvoluteRV)
    zones, back = _zones(scene, system, theta, np.nan_to_num(np.asarray(forces)))
    figure = Figure(figsize=(13.0, 5.2 * len(zones)), layout="constrained")
    axes = figure.subplots(2 * len(zones), 1, squeeze=False, height_ratios=(1.0, 1.0) * len(zones))[:, 0]
    factor = _factor(max(float(zone.gap.max()) for zone in zones), float(system.module))
    largest = max(max(float(zone.force.max()) for zone in zones), 1e-12)
    flanks = "back flanks carry, mirrored" if back else "driving flanks carry"
    for number, zone in enumerate(zones):
        teeth, bars = axes[2 * number : 2 * number + 2]
        centres = _draw_teeth(teeth, system, zone, factor, largest)
        _draw_loads(bars, zone, centres, np.pi * float(system.module) / mm)
        bars.set(xlim=teeth.get_xlim(), ylim=(0.0, 1.25 * max(float(zone.loads.max()) for zone in zones) or 1.0))
        crank = system.orders["crank"] * theta + 2 * np.pi * number / len(zones)
        gear = f"gear_{number + 1} in the ring, crank at {np.degrees(crank) % 360:.1f} deg, {flanks}"
        drawn = f"unloaded gaps enlarged {factor:g} times, forces on the ring, longest arrow {largest:.3g} N"
        teeth.set_title(f"{gear}: {drawn}", fontsize="medium")
    return figure


def save_pair_figure(scene: Scene, theta: float, forces: ArrayLike, path: Path) -> Path:
    """Write `pair_figure` as PNG.

    Raises:
        GearjaxError: the file cannot be written.
    """
    return save_figure(pair_figure(scene, theta, forces), path)


def _zones(scene: Scene, system: InvoluteRV, theta: float, forces: np.ndarray) -> tuple[list[Zone], bool]:
    """The pairs to draw of each external gear, on the flanks that carry more, and whether these are back flanks."""
    teeth, rolls, normals, gap = _seen(scene.precomputed("backlash"), jnp.asarray(theta, scene.dtype))
    places = []
    for pair_roll, (sine, cosine), base, centre in zip(
        rolls, normals, system.pair.base_radii, (float(system.centre_distance), 0.0), strict=True
    ):
        # the normal (sin, cos) is perpendicular to the radius (cos, -sin) of the base circle
        normal = np.asarray(sine) + 1j * np.asarray(cosine)
        places.append(centre + float(base) * (-1j + np.asarray(pair_roll)) * normal)
    place, gap = np.stack(places), np.asarray(gap)
    points = normal.shape[1:]
    along = (-1, *points, system.face_points)
    force, opening = forces.reshape(along).sum(axis=-1), gap.reshape(2, *along).mean(axis=-1)
    gears = system.gears
    back = bool(force[gears:].sum() > force[:gears].sum())
    blocks = range(gears, 2 * gears) if back else range(gears)
    tooth = np.mod(np.asarray(teeth), system.external_teeth)
    whole = [Zone(tooth[b], place[:, b], normal[b], opening[int(back), b], force[b]) for b in blocks]
    return [zone.only(_shown(zone)) for zone in whole], back


@eqx.filter_jit
def _seen(scene: Scene, theta: Scalar) -> tuple:
    """Teeth, roll angles and normals of the candidates on both gears, and their gaps.

    All flanks are described as driving flanks. The gaps are those at which the first driving flank just touches, and
    those at which the first back flank does.
    """
    scene, system = scene.anchored(), scene.system
    assert isinstance(system, InvoluteRV)
    at, contacts = system.candidates(theta, scene.has_back), scene.contacts(theta)
    touching = edges(scene, theta) if scene.has_back else (edge(scene, theta),) * 2
    gaps = jnp.stack([contacts.gap - contacts.jacobian[:, 0] * position for position in touching])
    return at.tooth, at.points.roll, at.normals, gaps


def _shown(zone: Zone) -> np.ndarray:
    """Indices of the pairs that carry or have the smallest gaps, and of some pairs next to them."""
    order = np.argsort(np.angle(zone.place[1, :, 0]))
    nearest = np.argsort(zone.gap.min(axis=1), kind="stable")
    wanted = (zone.loads > 0) | np.isin(np.arange(len(zone.tooth)), nearest[:FEWEST])
    inside = np.flatnonzero(wanted[order])
    return order[max(inside.min() - BESIDE, 0) : inside.max() + BESIDE + 1]


def _factor(largest: float, module: float) -> float:
    """Factor by which gaps are enlarged: 1, 2, 3 or 5 times a power of ten, at least one."""
    if not largest > 0:
        return 1.0
    wanted = max(WIDEST_GAP * module / largest, 1.0)
    power = 10.0 ** math.floor(math.log10(wanted))
    return power * max(step for step in (1, 2, 3, 5) if step * power <= wanted * (1 + 1e-9))


def _draw_teeth(ax: Axes, system: InvoluteRV, zone: Zone, factor: float, largest: float) -> np.ndarray:
    """Draw both gears, candidates and forces; return the positions of the pairs along the circumference [mm]."""
    pair, module = system.pair, float(system.module)
    middle, radius = float(np.angle(zone.place[1].mean())), float(pair.internal.reference_radius)

    def laid_out(place: np.ndarray) -> np.ndarray:
        """Coordinates along the circumference and outwards from the reference circle [mm]."""
        return np.stack([(np.angle(place) - middle) * radius, np.abs(place) - radius]) / mm

    behind = factor * zone.gap / float(pair.base_radii[0])  # angle by which external teeth stand behind [rad]
    gears = (pair.external, float(pair.centre_distance), behind, "tab:blue"), (pair.internal, 0.0, None, "0.35")
    for number, (gear, centre, turned, colour) in enumerate(gears):
        outline = centre + _outline(gear, zone.place[number] - centre, turned)
        ax.fill(*laid_out(outline), facecolor=colour, alpha=0.15, edgecolor="none")
        edge_of = outline[POINTS:-POINTS]
        ax.plot(*laid_out(edge_of), color=colour, linewidth=1.0, label="ring" if number else "external gear")
    centre = float(pair.centre_distance)
    touching = laid_out(centre + (zone.place[0] - centre) * np.exp(-1j * behind))
    facing = laid_out(zone.place[0])
    carries = zone.force > 0
    ax.plot(*np.stack([touching, facing], axis=1).reshape(2, 2, -1), color="0.5", linewidth=0.8)
    kinds = (carries, "tab:red", "loaded candidate contact"), (~carries, "white", "unloaded candidate contact")
    for chosen, face, words in kinds:
        ax.plot(*touching[:, chosen], "o", markersize=4, markerfacecolor=face, color="tab:red", label=words, zorder=4)
    turn = zone.normal * np.exp(-1j * np.angle(zone.place[0]))  # real part outwards, imaginary along the circumference
    arrows = np.stack([turn.imag, turn.real]) * zone.force / largest * LONGEST_ARROW * module / mm
    if carries.any():
        drawn = (part[:, carries] for part in (facing, arrows))
        ax.quiver(*np.concatenate(list(drawn)), angles="xy", scale_units="xy", scale=1, color="tab:red", width=1.5e-3)
    ax.set(aspect="equal", ylabel="outwards [mm]", xlabel="along the reference circle of the ring [mm]")
    ax.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    return facing[0].mean(axis=1)


def _outline(gear: InvoluteGear, place: np.ndarray, behind: np.ndarray | None) -> np.ndarray:
    """Teeth of a gear around its own axis, closed through its rim, complex [m].

    Args:
        gear: the gear.
        place: positions of the candidates on its driving flanks, shape (pair, point) [m]; the pairs are in order along
            the rotation of the crank.
        behind: angle by which the tooth stands behind at each of these positions [rad]; zero if ``None``.
    """
    tip, root = float(gear.tip_radius), float(gear.root_radius)
    radius = np.linspace(root, tip, POINTS)
    half = np.asarray(gear.half_angle(jnp.maximum(radius, gear.base_radius)))
    sign = -1.0 if gear.internal else 1.0  # driving flanks of the ring face the other way
    whole = []
    for row, own in enumerate(place):
        reach = np.abs(own)
        middle = float(np.mean(np.angle(own) - sign * np.asarray(gear.half_angle(jnp.asarray(reach)))))
        order = np.argsort(reach)
        lag = 0.0 if behind is None else np.interp(radius, reach[order], behind[row][order])
        flank = radius * np.exp(1j * (middle - lag - half)), radius * np.exp(1j * (middle - lag + half))
        whole += [flank[0], flank[1][::-1]]
    teeth = np.concatenate(whole)
    depth = root + (RIM if gear.internal else -RIM) * float(gear.module)
    ends = np.angle(teeth[0]), np.angle(teeth[-1])
    rim = depth * np.exp(1j * np.linspace(*ends, 2 * POINTS))
    return np.concatenate([rim[:POINTS][::-1], teeth, rim[POINTS:][::-1]])


def _draw_loads(ax: Axes, zone: Zone, centres: np.ndarray, pitch: float) -> None:
    """Draw the load of every pair below the teeth, with the smallest gap of the pair before the load."""
    ax.bar(centres, zone.loads, 0.6 * pitch, color="tab:red", alpha=0.7)
    for centre, load, gap in zip(centres, zone.loads, zone.gap.min(axis=1), strict=True):
        words = f"{load:.0f} N\n" if load > 0 else ""
        words += f"gap {max(gap, 0.0) / um:.2f} um"
        ax.annotate(words, (centre, load), ha="center", va="bottom", fontsize="small")
    ax.set_xticks(centres, [str(int(tooth)) for tooth in zone.tooth])
    ax.set(xlabel="tooth of the external gear", ylabel="load of the pair [N]")
    ax.grid(axis="y", alpha=0.3)
