"""`python -m steerkit`: the command line."""

from steerkit.cli import main

if __name__ == "__main__":
    main()
