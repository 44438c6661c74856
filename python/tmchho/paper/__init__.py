"""Every table and figure of the paper's experiments, run again and shown beside what is printed.

`reproduce` does it all; `tmchho paper` is its command line. One file holds each table or figure, another the
runs behind it; `tmchho.paper.store` keeps finished runs, so that an experiment of hours can be interrupted.
"""

from tmchho.paper.plan import Settings
from tmchho.paper.reproduce import SECTIONS, reproduce

__all__ = ["SECTIONS", "Settings", "reproduce"]
