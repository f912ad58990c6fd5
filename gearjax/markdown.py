"""Text on pages that gearjax writes in Markdown."""


def plain(words: str) -> str:
    """The text with its Markdown signs escaped, so that they are printed and have no effect."""
    for sign in ("|", "*", "_", "<", "[", "]"):
        words = words.replace(sign, f"\\{sign}")
    return words
