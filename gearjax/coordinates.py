"""Coordinates of a scene: the output, shafts that turn freely between two meshes, motions held by supports or shafts.

The motion of a body is a sum of coordinates. A body on a shaft turns with the shaft. If the shaft has a torsional
stiffness, each of its bodies but the reference body also has a twist, its rotation relative to the reference body. The
rotation of the shaft itself is that of the reference body.
"""

import dataclasses
import functools
import itertools
from collections.abc import Iterable, Mapping

import numpy as np

from gearjax.checks import ParameterError, SceneError, check_name, nearest, with_article
from gearjax.inertia import OF_WAY
from gearjax.shafts import Shaft
from gearjax.supports import TURNS, Support

Meshes = tuple[tuple[str, str], ...]
"""The two bodies of each mesh, the driving one first; meshes in order from the input."""


@dataclasses.dataclass(frozen=True)
class Coordinates:
    """Coordinates of a scene, and the motions of its bodies as sums of coordinates.

    The object holds no physical numbers: it is static and decides the structure of a compiled program.

    Args:
        names: names of the coordinates: the output, then the shafts that turn freely in order from the input, then the
            motions that supports and shafts hold.
        free: number of coordinates that only contacts hold; they come first.
        turns: whether each coordinate is an angle.
        motions: motions of bodies that the gear set must provide, such as ``disc_1.x``, each with the numbers of the
            coordinates that add up to it.
        rotations: rotations of the bodies of a train, each with the numbers of the coordinates that add up to it.
        holds: for each mesh, the number of the free coordinate that its driven body turns with.
    """

    names: tuple[str, ...]
    free: int
    turns: tuple[bool, ...]
    motions: tuple[tuple[str, tuple[int, ...]], ...]
    rotations: tuple[tuple[str, tuple[int, ...]], ...]
    holds: tuple[int, ...]

    @classmethod
    def of(cls, meshes: Meshes, supports: Mapping[str, Support], shafts: Mapping[str, Shaft]) -> "Coordinates":
        """Coordinates of a scene.

        Raises:
            SceneError: a body of a train is on no shaft, or no mesh drives a shaft that turns freely.
            ParameterError: a shaft lists a body that is in no mesh, or that is on another shaft already.
        """
        for body, support in supports.items():
            if meshes and body != meshes[0][0] and support.rz is not None:
                words = f"is only for {meshes[0][0]}: contacts and shafts hold the rotation of the other bodies"
                raise ParameterError(f"supports.{body}.rz", support.rz, words)
        # sorted, because JAX passes a dictionary to a program in the order of its keys
        ways = tuple(sorted((body, support.directions) for body, support in supports.items()))
        on = tuple(sorted((name, shaft.bodies, shaft.torsion is not None) for name, shaft in shafts.items()))
        return _coordinates(meshes, ways, on)

    @property
    def alone(self) -> bool:
        """Whether the output alone moves."""
        return len(self.names) == 1

    @property
    def asked(self) -> tuple[str, ...]:
        """Names of the motions that the gear set must provide."""
        return tuple(name for name, _ in self.motions)

    @property
    def rigid(self) -> "Coordinates":
        """Coordinates that remain if supports and shafts are rigid: the output, and shafts that turn freely."""
        names, turns = self.names[: self.free], self.turns[: self.free]
        motions, rotations = (_up_to(self.free, of) for of in (self.motions, self.rotations))
        return Coordinates(names, self.free, turns, motions, rotations, self.holds)

    @property
    def spread(self) -> np.ndarray:
        """Motions of the output and of the bodies per unit of each coordinate, shape (1 + motion, coordinate)."""
        return np.stack([self._row(places) for places in ((0,), *(places for _, places in self.motions))])

    @property
    def bodies(self) -> tuple[str, ...]:
        """Bodies that need an inertia of their own, in their order."""
        moving = dict.fromkeys(name.rpartition(".")[0] for name, _ in (*self.motions, *self._rotations))
        return tuple(body for body in moving if self.needs(body))

    def needs(self, body: str) -> tuple[str, ...]:
        """Kinds of inertia that a body needs: mass, polar, transverse.

        A body that turns with the output alone needs none, because the inertia of the output includes it.
        """
        ways = [
            name.rpartition(".")[2]
            for name, places in dict((*self.motions, *self._rotations)).items()
            if name.rpartition(".")[0] == body and places not in ((), (0,))
        ]
        return tuple(dict.fromkeys(OF_WAY[way] for way in ways))

    @property
    def _rotations(self) -> tuple[tuple[str, tuple[int, ...]], ...]:
        return tuple((f"{body}.rz", places) for body, places in self.rotations)

    def along(self, body: str, way: str) -> np.ndarray | None:
        """Motion of a body in one direction per unit of each coordinate, shape (coordinate,); ``None`` if rigid."""
        places = dict((*self.motions, *self._rotations)).get(f"{body}.{way}")
        return self._row(places) if places else None

    def _row(self, places: tuple[int, ...]) -> np.ndarray:
        row = np.zeros(len(self.names))
        row[list(places)] = 1.0
        return row


def _up_to(free: int, motions: Iterable[tuple[str, tuple[int, ...]]]) -> tuple[tuple[str, tuple[int, ...]], ...]:
    """The motions as sums of the first ``free`` coordinates alone."""
    left = [(name, tuple(place for place in places if place < free)) for name, places in motions]
    return tuple((name, places) for name, places in left if places)


def unit_of(coordinate: str) -> str:
    """Unit of a coordinate, from its name: rad for rotations of the output, shafts and bodies, m for displacements."""
    _, dot, way = coordinate.rpartition(".")
    return "rad" if not dot or way in (*TURNS, "twist") else "m"


def check_offered(
    kind: str, offered: Mapping[str, tuple[str, ...]], supports: Mapping[str, Support], shafts: Mapping[str, Shaft]
) -> None:
    """Refuse supports and shafts that do not suit a gear set.

    Args:
        kind: kind of the gear set.
        offered: directions in which each of its bodies can move.
        supports, shafts: the supports and shafts of the scene.

    Raises:
        SceneError: no body of the gear set can have supports or shafts.
        ParameterError: there is no such body, or it cannot move in a direction.
    """
    for slot, name in (*(("supports", name) for name in supports), *(("shafts", name) for name in shafts)):
        if not offered:
            raise SceneError(f"[{slot}.{name}] is not for {with_article(kind)}: its bodies have no coordinates")
    for body, support in supports.items():
        if body not in offered:
            raise ParameterError("supports", body, nearest(body, offered))
        for way in support.directions:
            if way not in offered[body]:
                words = f"{way} is no direction of {body}; {nearest(way, offered[body])}"
                raise ParameterError(f"supports.{body}.{way}", getattr(support, way), words)
    for name, shaft in shafts.items():
        check_name("shafts", name)
        if name == "output":
            raise ParameterError("shafts", name, "is the name of the output's rotation: give another name")
        turning = [body for body, ways in offered.items() if "rz" in ways]
        if not turning:
            raise SceneError(f"[shafts.{name}] is not for {with_article(kind)}: its bodies are on no shafts")
        for body in shaft.bodies:
            if body not in turning:
                raise ParameterError(f"shafts.{name}.bodies", body, nearest(body, turning))
        if shaft.bending is not None and not _bends(shaft, supports):
            words = "does nothing: it acts in x and y, where the supports of two bodies beside each other list these"
            raise ParameterError(f"shafts.{name}.bending", shaft.bending, words)


def _bends(shaft: Shaft, supports: Mapping[str, Support]) -> bool:
    """Whether two bodies beside each other on a shaft can be displaced in the same direction."""
    ways = [set(supports[body].directions) & {"x", "y"} if body in supports else set() for body in shaft.bodies]
    return any(one & other for one, other in itertools.pairwise(ways))


@functools.lru_cache(maxsize=512)  # a scene calls this each time that it evaluates its contacts
def _coordinates(
    meshes: Meshes, ways: tuple[tuple[str, tuple[str, ...]], ...], on: tuple[tuple[str, tuple[str, ...], bool], ...]
) -> Coordinates:
    """Coordinates of a scene.

    Args:
        meshes: meshes of the gear set.
        ways: for each body with a support, the directions that the support lists.
        on: for each shaft its name, its bodies, and whether it twists.
    """
    shafts = {name: bodies for name, bodies, _ in on}
    _check_shafts(meshes, shafts)
    ends = (meshes[0][0], meshes[-1][1]) if meshes else ("", "")
    own = {name: bodies for name, bodies in shafts.items() if not set(ends) & set(bodies)}
    driven = {name: [mesh for mesh, (_, body) in enumerate(meshes) if body in own[name]] for name in own}
    for name in own:
        if not driven[name]:
            raise SceneError(f"[shafts.{name}] turns freely: no mesh drives any of its bodies")
    loose = sorted(own, key=lambda name: driven[name][0])
    held = [f"{body}.{way}" for body, listed in ways for way in listed]
    twists = [
        f"{body}.twist" for _, bodies, twisting in on if twisting for body in bodies if body != _first(bodies, ends)
    ]
    names = ("output", *loose, *held, *twists)
    drive = f"{ends[0]}.rz"
    base = {ends[0]: (names.index(drive),) if drive in names else (), ends[1]: (0,)}
    rotations = dict(base) if meshes else {}
    for name, bodies in shafts.items():
        turn = (names.index(name),) if name in own else base[_first(bodies, ends)]
        for body in bodies:
            rotations[body] = turn + ((names.index(f"{body}.twist"),) if f"{body}.twist" in names else ())
    motions = [(name, (names.index(name),)) for name in held if name != drive]
    motions += [(f"{body}.rz", turn) for body, turn in rotations.items() if turn and body != ends[1]]
    turns, free = tuple(unit_of(name) == "rad" for name in names), 1 + len(loose)
    return Coordinates(names, free, turns, tuple(motions), tuple(rotations.items()), _holds(meshes, rotations, free))


def _first(bodies: tuple[str, ...], ends: tuple[str, str]) -> str:
    """The reference body of a shaft: the body that turns with the input or the output, else the first of the shaft."""
    return next((body for body in bodies if body in ends), bodies[0])


def _check_shafts(meshes: Meshes, shafts: Mapping[str, tuple[str, ...]]) -> None:
    """Refuse shafts that are impossible, and trains that lack shafts."""
    bodies = tuple(dict.fromkeys(body for mesh in meshes for body in mesh))
    places = [(body, name) for name, own in shafts.items() for body in own]
    for body, name in places:
        if not meshes:
            raise SceneError(f"[shafts.{name}] is for a train of wheels: leave it out")
        if body not in bodies:
            raise ParameterError(f"shafts.{name}.bodies", body, nearest(body, bodies))
        for other in (other for at, other in places if at == body and other != name):
            raise ParameterError(f"shafts.{name}.bodies", body, f"is on [shafts.{other}] already")
    on = {body for body, _ in places}
    for body in bodies:
        if body not in (*on, meshes[0][0], meshes[-1][1]):
            words = f'list [shafts.NAME] with bodies = ["{body}", ...]'
            raise SceneError(f"{body} must share a shaft with another body of the train: {words}")
    for name, own in shafts.items():
        if meshes and {meshes[0][0], meshes[-1][1]} <= set(own):
            raise SceneError(f"[shafts.{name}] joins the input to the output: nothing is left to move")


def _holds(meshes: Meshes, rotations: Mapping[str, tuple[int, ...]], free: int) -> tuple[int, ...]:
    """For each mesh, the free coordinate that its driven body turns with.

    Raises:
        SceneError: motion is not passed on from the input to the output, from one shaft to the next.
    """
    driven, drivers = [], []
    for driver, body in meshes:
        free_of = [next((at for at in rotations[end] if at < free), None) for end in (driver, body)]
        if free_of[1] is None:
            raise SceneError(f"the mesh of {driver} and {body} drives the input's shaft: it must drive a later shaft")
        if free_of[0] is not None and (free_of[0] == 0 or 0 < free_of[1] <= free_of[0]):
            raise SceneError(
                f"the mesh of {driver} and {body} drives a shaft that comes before {driver}, seen from the input"
            )
        driven.append(free_of[1])
        drivers.append(free_of[0])
        if len(sources := {turn for turn, held in zip(drivers, driven, strict=True) if held == free_of[1]}) > 1:
            words = "torque that splits between shafts is not modelled"
            raise SceneError(f"the shaft of {body} is driven by {len(sources)} independent shafts: {words}")
    return tuple(driven)
