"""``python -m semlive``."""

from semlive.cli.main import main

if __name__ == "__main__":
    main()
