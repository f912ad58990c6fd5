"""Names of the papers that are reproduced, which a shell completes without importing what reproduces them."""

NAMES = ("two_kv", "rv_cycloidal", "involute_rv", "helical", "elliptic")
