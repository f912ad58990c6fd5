"""Configurations: TOML files that list what a scene models and what to compute."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # what is imported when it is first used
