"""How well a car was steered and what learning it cost, in numbers with sources; `table.csv` lists them all."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
