"""Array types of the package: floats in SI units, or integers."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
WholeArray: TypeAlias = NDArray[np.int64]
