"""The constants of the diagnosis, in sections."""

from flexx2_sim_ros.gap.calibration.data import BINNING, GROUND_TRUTH, READING, REGISTRATION
from flexx2_sim_ros.gap.calibration.features import FEATURES, MEASURES, SIMULATION
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.calibration.inference import LOSS, MODE, ROUNDS, THRESHOLDS, UNLIKE, WHERE

SECTIONS = (
    READING,
    REGISTRATION,
    GROUND_TRUTH,
    BINNING,
    FEATURES,
    MEASURES,
    SIMULATION,
    LOSS,
    THRESHOLDS,
    ROUNDS,
    UNLIKE,
    MODE,
    WHERE,
    FORMS,
)
