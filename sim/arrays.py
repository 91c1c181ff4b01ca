"""What arrays hold here: floats in SI units, or whole numbers."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
WholeArray: TypeAlias = NDArray[np.int64]
