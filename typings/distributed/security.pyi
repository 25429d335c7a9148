from typing import Self

class Security:
    @classmethod
    def temporary(cls) -> Self: ...
