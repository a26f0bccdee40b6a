"""The one face that methods, datasets and programs around them see: `from vprbench.api import Method, Images`.

A name is imported when a program asks for it, so a method without torch does not wait for torch. The names stand in
`__init__.pyi`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
