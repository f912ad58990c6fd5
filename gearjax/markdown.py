"""Words on pages that gearjax writes in Markdown."""


def plain(words: str) -> str:
    """Words in which Markdown finds nothing to do."""
    for sign in ("|", "*", "_", "<", "[", "]"):
        words = words.replace(sign, f"\\{sign}")
    return words
