"""What of the configuration the data contradict: kinds of events."""

from __future__ import annotations

from tramstream.events.kinds import ERROR, define

_MOUNTING = (
    "set $.imu.mounting_deg near [{mounting_roll_deg}, {mounting_pitch_deg}, {mounting_yaw_deg}]"
)

MOUNTING_TILTED = define(
    "configuration_check.mounting_tilted",
    "at a stand gravity comes {tilt_deg} from where $.imu.mounting_deg puts up, limit {limit_deg}",
    cause="The IMU's case is mounted otherwise than is configured, or an axis has another sign; no "
    "track leans so much.",
    cure=_MOUNTING + ", which puts gravity upright; the yaw shows at a departure",
    severity=ERROR,
    tilt_deg=float,
    limit_deg=float,
    mounting_roll_deg=float,
    mounting_pitch_deg=float,
    mounting_yaw_deg=float,
)
MOUNTING_DIFFERS = define(
    "configuration_check.mounting_differs",
    "over {stands} stands gravity comes {tilt_deg} from where the mounting of {origin} puts up, "
    "limit {limit_deg}; it is used on, as the last that was good",
    cause="The IMU was moved or exchanged since it was calibrated. A line whose stops all lean to "
    "one side shows less.",
    cure="calibrate again (`tramstream align`); until then: " + _MOUNTING,
    severity=ERROR,
    stands=int,
    tilt_deg=float,
    limit_deg=float,
    origin=str,
    mounting_roll_deg=float,
    mounting_pitch_deg=float,
    mounting_yaw_deg=float,
)
MOUNT_CHANGED = define(
    "configuration_check.mount_changed",
    "the IMU was moved in the vehicle {ago_s} ago: its case is tilted by {tilt_deg} (± "
    "{tilt_std_deg}) and turned about the vertical by {turned_deg} (± {turned_std_deg}); the "
    "mounting of {origin} is used on, as the last that was good",
    cause="A loose holder, or somebody worked on it. Nothing that the wheels and the gyroscopes "
    "say of the motion explains how gravity and driving are read now.",
    cure="fasten the IMU and calibrate again (`tramstream align`) by what comes after this instant",
    severity=ERROR,
    ago_s=float,
    tilt_deg=float,
    tilt_std_deg=float,
    turned_deg=float,
    turned_std_deg=float,
    origin=str,
)
GRAVITY_WRONG = define(
    "configuration_check.gravity_wrong",
    "at a stand the accelerometers read {force_mps2} in all, gravity is {gravity_mps2}, limit "
    "{limit_mps2} of difference",
    cause="The accelerometers' scale or unit is another (g, mg), or an axis is dead or clipped.",
    cure="look at $.imu.model, the firmware's scale, and sync/imu/mean",
    severity=ERROR,
    force_mps2=float,
    gravity_mps2=float,
    limit_mps2=float,
)
MOUNTING_TURNED = define(
    "configuration_check.mounting_turned",
    "the force of {windows} moments of driving comes {turned_deg} (± {turned_std_deg}) to the left "
    "of where the wheels accelerate, limit {limit_deg}",
    cause="The IMU's case is turned about the vertical against what is configured.",
    cure=_MOUNTING,
    severity=ERROR,
    windows=int,
    turned_deg=float,
    turned_std_deg=float,
    limit_deg=float,
    mounting_roll_deg=float,
    mounting_pitch_deg=float,
    mounting_yaw_deg=float,
)
WHEELS_BACKWARDS = define(
    "configuration_check.wheels_backwards",
    "the wheels count forwards where the IMU feels the tram drive backwards ({turned_deg} between "
    "them, {windows} moments of driving)",
    cause="The wheels' sign is wrong, or the IMU's case is turned by 180°. A tram whose wheels "
    "have no sign shows the same where the other cab leads; then nothing is wrong.",
    cure="turn the sign of $.odometer.wheels.*.scale, or turn $.imu.mounting_deg by 180° of yaw",
    turned_deg=float,
    windows=int,
)
WHEEL_SCALE = define(
    "configuration_check.wheel_scale",
    "wheels say {wheel_mps} where fixes say {fix_mps}: a factor of {factor} (± {factor_std}) over "
    "{fixes} fixes, limit {limit} to either side",
    cause="The wheels' scale or unit is another than is configured: km/h for m/s, millimetres, one "
    "edge or both, another wheel.",
    cure="multiply $.wheels.m_per_pulse, or $.odometer.wheels.*.scale of wheels that give a speed, "
    "by {factor}; this looks like {likely}",
    severity=ERROR,
    wheel_mps=float,
    fix_mps=float,
    factor=float,
    factor_std=float,
    fixes=int,
    limit=float,
    likely=str,
)
FIX_SPEED_SCALE = define(
    "configuration_check.fix_speed_scale",
    "fixes say {fix_mps} where wheels say {wheel_mps}: a factor of {factor} (± {factor_std}) over "
    "{fixes} fixes, limit {limit} to either side; the IMU's force agrees with the wheels",
    cause="The fixes' speed has another unit (knots, km/h), or the receiver is deceived.",
    cure="look at the mapping or the receiver's messages; this looks like {likely}",
    severity=ERROR,
    fix_mps=float,
    wheel_mps=float,
    factor=float,
    factor_std=float,
    fixes=int,
    limit=float,
    likely=str,
)
FIX_DELAY = define(
    "configuration_check.fix_delay",
    "the fixes' speed is {delay_s} (± {delay_std_s}) later than the wheels', limit {limit_s}",
    cause="The receiver's delay, or the wheels', is another than is configured, or a clock is off.",
    cure="set $.gnss.receiver_delay_s to {receiver_delay_s} if the wheels are right, else "
    "$.wheels.delay_s to {wheel_delay_s}",
    delay_s=float,
    delay_std_s=float,
    limit_s=float,
    receiver_delay_s=float,
    wheel_delay_s=float,
)
STAMPS_LATE = define(
    "configuration_check.stamps_late",
    "{key}: {share_percent} of {messages} messages in the last {span_s} came after the fusion "
    "horizon had passed their stamps, in the mean {late_s} after it; they are not used",
    cause="The device's clock is behind, or its messages take longer than is allowed for.",
    cure="correct the delay that is configured for the device, or raise $.resampler.horizon_lag_s "
    "beyond {needed_s}",
    severity=ERROR,
    key=str,
    share_percent=float,
    messages=int,
    span_s=float,
    late_s=float,
    needed_s=float,
)
LEVER_ARM = define(
    "configuration_check.lever_arm",
    "in curves the antenna moves as if it were {found_m} (± {found_std_m}) {direction} of the "
    "point that does not slip sideways, configured are {configured_m}, limit {limit_m} of "
    "difference",
    cause="The antenna is elsewhere than is configured, or the vehicle's origin is not the point "
    "that does not slip sideways, between its bogies.",
    cure="measure $.gnss.lever_arm_m again, and $.ekf.pivot_m and $.ekf.bogie_distance_m",
    direction=str,
    found_m=float,
    found_std_m=float,
    configured_m=float,
    limit_m=float,
)
