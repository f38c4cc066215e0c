"""`python -m benchmarks`: the same commands as `steerkit bench`."""

from benchmarks.app import main

if __name__ == "__main__":
    main()
