"""The drawing of signs in the manual: which way torque, transmission error, gaps and backlash count.

python experiments/signs_figure.py
"""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from gearjax.plot import new_figure, save_figure

INPUT, OUTPUT = "#c7d9e8", "#f0d2b6"
FLANK = 0.35  # by which a flank leans


def tooth(ax: Axes, left: float, right: float, up: bool, colour: str, words: str) -> None:
    """A tooth between two places on the pitch line, pointing up or down."""
    root, tip = (-0.9, 0.7) if up else (1.5, -0.3)
    corners = [(left - FLANK, root), (left + FLANK, tip), (right - FLANK, tip), (right + FLANK, root)]
    ax.add_patch(Polygon(corners, facecolor=colour, edgecolor="0.3"))
    ax.text((left + right) / 2, (root + tip) / 2, words, ha="center", va="center", fontsize=9)


def arrow(ax: Axes, start: tuple[float, float], end: tuple[float, float], words: str, colour: str = "0.15") -> None:
    ax.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "-|>", "color": colour, "shrinkA": 0, "shrinkB": 0})
    ax.text((start[0] + end[0]) / 2, start[1] + 0.1, words, ha="center", va="bottom", fontsize=9, color=colour)


def main() -> None:
    figure, (ax,) = new_figure(width=8.0, height=4.0)
    tooth(ax, 0.0, 2.0, True, INPUT, "input")
    tooth(ax, 2.35, 4.35, False, OUTPUT, "output")
    tooth(ax, 5.0, 7.0, True, INPUT, "input")
    ax.plot([2.8, 2.8], [-1.25, 2.0], color="0.4", linestyle=":")
    ax.plot([3.35, 3.35], [-1.25, 2.0], color="0.4")
    ax.text(2.75, -1.2, "ideal place", ha="right", va="bottom", fontsize=9, color="0.3")
    arrow(ax, (2.8, 1.75), (3.35, 1.75), "", "#009E73")
    ax.text(3.45, 1.75, "TE > 0: ahead of the ideal place", va="center", fontsize=9, color="#009E73")
    arrow(ax, (1.95, 0.2), (2.4, 0.2), "")
    ax.annotate(
        "driving flanks: gap > 0,\nclosed by a torque > 0",
        (2.15, 0.2),
        (-0.3, 1.35),
        fontsize=9,
        arrowprops={"arrowstyle": "-", "color": "0.5"},
    )
    ax.annotate("back flanks", (4.7, 0.2), (4.9, 1.35), fontsize=9, arrowprops={"arrowstyle": "-", "color": "0.5"})
    arrow(ax, (4.9, 2.35), (3.6, 2.35), "torque > 0: a load that resists", "#D55E00")
    arrow(ax, (0.4, 2.35), (1.9, 2.35), "both move this way as the input turns")
    ax.text(
        3.6, -1.75, "backlash: all travel of the output between its flanks, both gaps together", fontsize=9, ha="center"
    )
    ax.set(xlim=(-0.6, 7.6), ylim=(-2.0, 3.0), aspect="equal")
    ax.axis("off")
    save_figure(figure, Path(__file__).with_name("site") / "signs.png")


if __name__ == "__main__":
    main()
