from .names import NAMES
from .page import validation_page
from .papers import PAPERS, Paper
from .rows import Row

__all__ = ["NAMES", "PAPERS", "Paper", "Row", "validation_page"]
