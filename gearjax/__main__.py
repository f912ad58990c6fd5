"""``python -m gearjax``."""

from gearjax.cli import main

if __name__ == "__main__":
    main()
