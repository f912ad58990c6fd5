"""The example configurations that come with the package."""

import shutil
from pathlib import Path

import gearjax
from gearjax.checks import GearjaxError, ParameterError, nearest

INSTALLED = "examples"  # folder inside an installed package; in a clone the examples are beside the package, in configs


def examples() -> dict[str, Path]:
    """Folders of the example configurations, by name.

    Raises:
        GearjaxError: the package was installed without them.
    """
    package = Path(gearjax.__file__).parent
    places = [folder for folder in (package / INSTALLED, package.parent / "configs") if (folder / "two_kv").is_dir()]
    if not places:
        raise GearjaxError(
            "this installation has no example configurations: install gearjax again, or from a clone of its repository"
        )
    return {folder.name: folder for folder in sorted(places[0].iterdir()) if folder.is_dir()}


def copy_example(name: str, folder: Path) -> list[Path]:
    """Copy the configurations of one example and the files that they name.

    Args:
        name: name of the example, such as ``two_kv``; a kind of gear set is accepted too.
        folder: folder to copy the files to; it is created if it does not exist.

    Returns:
        Paths of the copied configurations.

    Raises:
        ParameterError: there is no such example.
        GearjaxError: the folder already has a file of one of the names, or it cannot be written.
    """
    known = examples()
    name = name if name in known else name.removesuffix("_pair")
    if name not in known:
        raise ParameterError("example", name, nearest(name, known))
    files = sorted(path for path in known[name].iterdir() if path.is_file())
    for file in files:
        if (folder / file.name).exists():
            raise GearjaxError(f"{folder / file.name}: exists already and is not overwritten: give another --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file in files:
            shutil.copyfile(file, folder / file.name)
    except OSError as fault:
        raise GearjaxError(f"--out {folder}: cannot be written ({fault.strerror})") from fault
    return [folder / file.name for file in files if file.suffix == ".toml" and not file.with_suffix(".csv").exists()]
