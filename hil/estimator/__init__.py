"""Pose estimation: wheel odometry, EKF and UKF behind one interface, `hil.core.interfaces.Estimator`."""

from hil.config.estimator import EstimatorConfig, check_scales
from hil.core.errors import ConfigError
from hil.core.interfaces import Estimator
from hil.robot.kinematics import WheelGeometry

SURFACES = ("wall", "floor")


def make_estimator(
    config: EstimatorConfig, geometry: WheelGeometry, *, surface: str, diagnostics: bool = True
) -> Estimator:
    """Make the estimator that a configuration selects.

    Args:
        config: `[estimator]` of the bench file.
        geometry: calibrated wheel parameters.
        surface: `wall` (gravity lies in the motion plane) or `floor`.
        diagnostics: True if the filter's states contain diagnostics; those of an observer are not read.

    Raises:
        ConfigError: an unknown surface, or two free scales.
    """
    if surface not in SURFACES:
        raise ConfigError(f"estimator: surface {surface!r}", expected="one of " + ", ".join(SURFACES))
    check_scales(config)
    if config.kind == "odometry":
        from hil.estimator.wheel_odometry import OdometryEstimator

        return OdometryEstimator(config, geometry, surface)
    from hil.estimator.fusion import FilterBackend, FusionEstimator, NumbaFilter
    from hil.estimator.kernel_layout import parameters
    from hil.estimator.sigma_points import points_of

    given = parameters(config, geometry, surface)
    engine: FilterBackend
    if config.engine == "filterpy":
        from hil.estimator.filterpy_engine import FilterpyFilter

        engine = FilterpyFilter(given, config)
    else:
        engine = NumbaFilter(given, points_of(config))
    return FusionEstimator(config, geometry, surface, engine, diagnostics=diagnostics)
