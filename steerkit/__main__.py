"""`python -m steerkit`: the command line."""

from steerkit.cli.app import main

if __name__ == "__main__":
    try:
        main()
    finally:
        # CPython remembers an interrupt inside exec or eval of a text (dataclasses do that, namedtuple and our wiring)
        # and lets `python -m` end by the signal, whatever exit code main asks for; another text makes it forget
        exec("")
