"""Sketch of a gear set at input angle zero: where its bodies are, and where the phases of their errors begin.

A sketch is not to scale; its lengths are shares of the size of the drawing. The input turns counter-clockwise, or the
crank does, where there is one.
"""

import dataclasses
import math

Point = tuple[float, float]
MIDDLE: Point = (0.0, 0.0)
THROW = 0.3  # length of a throw in a sketch; the radius of the ring is 1
CLOCKWISE, ANTICLOCKWISE = -1, 1


@dataclasses.dataclass(frozen=True)
class SketchedBody:
    """A body that may carry errors, as it is drawn.

    The phase p of an error points in the direction ``zero + sense p``.

    Args:
        name: name of the body.
        axis: place of its axis.
        radius: radius of its circle; 0 for a body that is not drawn as a circle.
        zero: direction of phase zero, counter-clockwise from the x axis of the drawing [rad]; ``None`` if the drawing
            does not show it.
        sense: sense in which phases are counted, 1 counter-clockwise, -1 clockwise.
        turns: sense in which the body turns, 1 counter-clockwise, -1 clockwise, 0 if it stands still.
        frame: direction of the x axis of its supports [rad].
        outline: closed pitch curve in place of a circle, shape (point, 2).
    """

    name: str
    axis: Point = MIDDLE
    radius: float = 0.0
    zero: float | None = 0.0
    sense: int = ANTICLOCKWISE
    turns: int = 0
    frame: float = 0.0
    outline: tuple[Point, ...] = ()


@dataclasses.dataclass(frozen=True)
class Sketch:
    """Sketch of a gear set.

    Args:
        bodies: bodies that may carry errors.
        pitch_points: pitch point of each drawn mesh, with the body whose contacts are there.
        throws: direction of the throw of each crank [rad].
        output: place, radius and sense of rotation of the output.
    """

    bodies: tuple[SketchedBody, ...]
    pitch_points: tuple[tuple[Point, str], ...]
    throws: tuple[float, ...]
    output: tuple[Point, float, int]

    def body(self, name: str) -> SketchedBody:
        """The body of a name."""
        return next(body for body in self.bodies if body.name == name)


def beyond(place: Point, direction: float, distance: float) -> Point:
    """Point in a direction [rad] from a place."""
    return place[0] + distance * math.cos(direction), place[1] + distance * math.sin(direction)


def on_cranks(
    wheels: tuple[SketchedBody, ...], throws: tuple[float, ...], others: tuple[SketchedBody, ...], *, mesh: bool = True
) -> Sketch:
    """Sketch of wheels that cranks carry around in a ring; the output turns against the crank, in the middle.

    Args:
        wheels: the wheels, whose place, radius, rotation and axes of supports follow from the throws.
        throws: direction of the throw of each wheel [rad].
        others: other bodies.
        mesh: whether each wheel has a pitch point in the direction of its throw.
    """
    placed = tuple(
        dataclasses.replace(wheel, axis=beyond(MIDDLE, throw, THROW), radius=1 - THROW, turns=CLOCKWISE, frame=throw)
        for wheel, throw in zip(wheels, throws, strict=True)
    )
    points = tuple(
        (beyond(MIDDLE, throw, 1.0), wheel.name) for wheel, throw in zip(placed, throws, strict=True) if mesh
    )
    return Sketch((*placed, *others), points, throws, (MIDDLE, 0.55, CLOCKWISE))
