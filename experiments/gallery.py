# %% [markdown]
# # One picture per gear set, for the readme
#
# `python experiments/gallery.py` runs each configuration with `gearjax run` and keeps one of its figures, as
# `experiments/gallery_KIND.png`.

# %%
import contextlib
import tempfile
from pathlib import Path

from gearjax.cli import main

HERE = Path(__file__).parent
PICTURES = {
    "two_kv": ("two_kv/wang_2020.toml", "transmission_error.png"),
    "rv_cycloidal": ("rv_cycloidal/hu_2020.toml", "stage.png"),
    "involute_rv": ("involute_rv/yang_2019.toml", "pair.png"),
    "helical_pair": ("helical/guo_2018.toml", "plane_of_action.png"),
    "elliptic_pair": ("elliptic/dong_2020.toml", "pair.png"),
}


def draw(folder: Path = HERE) -> None:
    for kind, (config, figure) in PICTURES.items():
        with tempfile.TemporaryDirectory() as out:
            with contextlib.suppress(SystemExit):  # a fault ends in a line, and in no figure below
                main(["run", str(HERE.parent / "configs" / config), "--out", out])
            (folder / f"gallery_{kind}.png").write_bytes((Path(out) / figure).read_bytes())


if __name__ == "__main__":
    draw()
