"""Data of the paper: its bristle, measurements and results, each with its place in the text.

Vanegas-Useche, Abdel-Wahab and Parker, "Determination of the Normal Contact Stiffness and
Integration Time Step for the Finite Element Modeling of Bristle-Surface Interaction", Computers,
Materials & Continua 56(1), 2018. SI units.
"""

from typing import Final

CITATION: Final = (
    "Vanegas-Useche, Abdel-Wahab and Parker, Computers, Materials & Continua 56(1), 2018"
)

# The bristle and its material (section on the finite element model).
LENGTH_M: Final = 0.3365
WIDTH_M: Final = 2.08e-3
THICKNESS_M: Final = 0.50e-3
MASS_KG: Final = 2.73e-3
YOUNGS_PA: Final = 207e9
POISSON: Final = 0.28
DENSITY_KG_M3: Final = 7800.0
FRICTION: Final = 0.5
GRAVITY_M_S2: Final = 9.8
BETA_S: Final = 0.0107e-3
ALPHA_1_S: Final = 0.0
ELEMENTS: Final = 16

# The simulated cases (Figs. 9 and 13).
HEIGHTS_M: Final = (0.01, 0.02, 0.03, 0.04, 0.05)
KN_N_M: Final = (1e4, 1e5, 5e5, 7.5e5, 1e6, 2e6, 3e6, 4e6, 5e6, 1e7, 1e8)
ITS_S: Final = 0.01e-3
KN_CHOSEN_N_M: Final = 2e6
FIG9_HEIGHTS_M: Final = (0.01, 0.03, 0.05)

# The measured drops (Figs. 10 to 12): 26 drops filmed at 25 frames a second.
N_DROPS: Final = 26
FRAMES_PER_S: Final = 25.0
RATIO_MEAN: Final = 0.65
RATIO_STD: Final = 0.21
RATIO_BAND_90: Final = (0.30, 1.00)
R2_LINEAR: Final = 0.7326
R2_QUADRATIC: Final = 0.7394
KNOWN_DROP_M: Final = (0.0505, 0.034)

# Simulated y1/y0 at the three stiffnesses that the paper quotes.
RATIO_AT_KN: Final = {1e4: 1.0, 2e6: 0.65, 1e8: 0.3}
# Eq. 8 evaluated in the text: time from impact to greatest penetration.
TIME_TO_PEAK_S: Final = {1e4: 0.82e-3, 1e8: 0.01e-3}
