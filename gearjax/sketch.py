"""Sketch of a gear set at input angle zero: where its bodies are, and where the phases of their errors begin.

A sketch is not to scale; its lengths are shares of the size of the drawing. The input turns counter-clockwise, or the
crank does, where there is one.
"""

import dataclasses
import math

Point = tuple[float, float]
THROW = 0.3  # length of a throw in a sketch; the radius of the ring is 1
CLOCKWISE, ANTICLOCKWISE = -1, 1


@dataclasses.dataclass(frozen=True)
class SketchedBody:
    """A body that may carry errors, as it is drawn.

    The phase p of an error points in the direction ``zero + sense p``. A displacement d of the body changes the gaps by
    ``share n d``, where n is the change of the gaps per displacement of the body ``seen_by``, which may have a support.

    Args:
        name: name of the body.
        axis: place of its axis.
        radius: radius of its circle; 0 for a body that is not drawn as a circle.
        zero: direction of phase zero, counter-clockwise from the x axis of the drawing [rad]; ``None`` if the drawing
            does not show it.
        sense: sense in which phases are counted, 1 counter-clockwise, -1 clockwise.
        turns: sense in which the body turns, 1 counter-clockwise, -1 clockwise, 0 if it stands still.
        frame: direction of the x axis of the supports of ``seen_by`` [rad].
        seen_by: body with supports that touches the same flanks; the body itself if empty.
        share: 1 if a displacement of the body acts like one of ``seen_by``, -1 if it acts against it.
        outline: closed pitch curve in place of a circle, shape (point, 2).
    """

    name: str
    axis: Point
    radius: float = 0.0
    zero: float | None = 0.0
    sense: int = ANTICLOCKWISE
    turns: int = 0
    frame: float = 0.0
    seen_by: str = ""
    share: int = 1
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


def at(direction: float, distance: float) -> Point:
    """Point in a direction [rad] from the middle of the drawing."""
    return distance * math.cos(direction), distance * math.sin(direction)


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
        dataclasses.replace(wheel, axis=at(throw, THROW), radius=1 - THROW, turns=CLOCKWISE, frame=throw)
        for wheel, throw in zip(wheels, throws, strict=True)
    )
    points = tuple((at(throw, 1.0), wheel.name) for wheel, throw in zip(placed, throws, strict=True) if mesh)
    return Sketch((*placed, *others), points, throws, ((0.0, 0.0), 0.55, CLOCKWISE))
