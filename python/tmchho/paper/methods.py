"""The optimisers that are compared, in the order of the paper's tables, and what pages call them."""

from __future__ import annotations

PAPER_METHODS = ("boa", "woa", "pso", "doa", "hho", "tmchho")
OURS = "tmchho_free"
LIBRARY_METHODS = ("cma_es", "de")

_TITLES = {"tmchho_free": "TMCHHO-free (ours)", "cma_es": "CMA-ES", "de": "DE", "icp": "ICP alone"}
_TITLES |= {"robust": "robust mode", "truth": "true pose"}


def title(method: str) -> str:
    """Return what a page calls a method.

    Examples
    --------
    >>> title("hho"), title("cma_es")
    ('HHO', 'CMA-ES')
    """
    return _TITLES.get(method, method.upper())
