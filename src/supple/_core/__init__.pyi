# The types of what bindings.cpp defines.
from collections.abc import Sequence

isa: str

def threads() -> int: ...

class Polynomial:
    def __init__(self, coefficients: Sequence[float]) -> None: ...
    def at(self, x: float) -> float: ...
