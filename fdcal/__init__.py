"""fdcal: microphone positions from the resonances of a room.

After Nowakowski, Daudet, de Rosny, "Microphone array position calibration in the frequency domain
using a single unknown source". Eq. 7 of the paper is in `fdcal.cost.eq7`, Eqs. 3, 4 and 9 in
`fdcal.acoustics.fourier_bessel`.
"""

import os

# The matrices here are small: BLAS threads cost more than they bring. Must be set before NumPy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
