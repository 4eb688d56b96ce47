"""What in a text tells whose machine it was made on: absolute paths. (Records state neither user nor host.)"""

from __future__ import annotations

import re

PATHS = re.compile(r"""(?<![\w/.:%-])(?:/|~/|[A-Za-z]:\\\\?)(?:[\w.+ -]+[/\\]+)+[\w.+-]+""")


def private_paths(text: str) -> list[str]:
    """Return the absolute paths in a text, each once.

    >>> private_paths('{"weights": "/home/ada/vgg.npz", "shape": "3/4", "url": "https://a.org/b/c"}')
    ['/home/ada/vgg.npz']
    """
    return list(dict.fromkeys(PATHS.findall(text)))
