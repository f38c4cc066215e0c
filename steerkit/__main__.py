"""`python -m steerkit`: the command line."""

from steerkit.cli.app import main

if __name__ == "__main__":
    main()
