"""``python -m tmchho`` is the command ``tmchho``."""

from tmchho.cli import main

if __name__ == "__main__":
    main(prog_name="tmchho")
