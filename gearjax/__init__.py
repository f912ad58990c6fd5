"""gearjax: differentiable gear dynamics in JAX: transmission error without load, under static load and in motion."""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # what is imported when it is first used
