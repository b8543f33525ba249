"""What the filter `tram` does not believe, misses and begins anew: kinds of events.

The limit of a refusal is that of the innovation gate: so many deviations of the innovation, which
are those of the filter and of the measurement together (docs/theory.md, section 6). The number of
deviations is a constant, for it says how rarely an honest measurement is refused; what a
measurement is taken to err is set, and named by each kind.
"""

from __future__ import annotations

from tramstream.events.kinds import DEBUG, ERROR, INFO, define

FIX_REFUSED = define(
    "tram.fix_refused",
    "{key}: a fix is refused, innovation {innovation_m}, limit {limit_m}: {gate_sigma} of filter "
    "and receiver, which says {accuracy_m}",
    cause="Multipath, a spoofed or repeated fix, or a filter that is wrong. After 8 s it is taken "
    "for a new error of the fixes. $.gnss.error_floor_m is the least that a receiver is taken to "
    "err.",
    cure="if good fixes are refused, raise $.gnss.error_floor_m",
    key=str,
    innovation_m=float,
    limit_m=float,
    gate_sigma=float,
    accuracy_m=float,
)
VELOCITY_REFUSED = define(
    "tram.velocity_refused",
    "{key}: a velocity is refused, innovation {innovation_mps}, limit {limit_mps}: {gate_sigma} of "
    "filter and receiver, which says {accuracy_mps}",
    cause="Multipath, wheels that slip, or a clock of the receiver that is off: the velocity is of "
    "another instant. The receiver states its own accuracy (speed_std_mps).",
    cure="if it happens whenever the tram brakes, correct $.gnss.receiver_delay_s",
    key=str,
    innovation_mps=float,
    limit_mps=float,
    gate_sigma=float,
    accuracy_mps=float,
)
WHEEL_REFUSED = define(
    "tram.wheel_refused",
    "{key}: the way of wheel {wheel} is refused, innovation {innovation_m}, limit {limit_m}: "
    "{gate_sigma} of filter and wheel ($.wheels.stamp_std_s, $.wheels.m_per_pulse)",
    cause="The wheel slips or slides; it is believed again when it has gone the filter's way for "
    "0.8 s, or after 20 s.",
    cure="if it happens on dry rail, correct $.wheels.m_per_pulse",
    severity=DEBUG,
    key=str,
    wheel=str,
    innovation_m=float,
    limit_m=float,
    gate_sigma=float,
)
WHEEL_SPEED_REFUSED = define(
    "tram.wheel_speed_refused",
    "{key}: the speed of wheel {wheel} is refused, innovation {innovation_mps}, limit {limit_mps}: "
    "{gate_sigma} of filter and wheel ($.wheels.speed_std_mps)",
    cause="The wheel slips or slides; after 20 s the filter's speed is taken to be wrong.",
    cure="if it happens on dry rail, correct the signal's scale in the DBC",
    severity=DEBUG,
    key=str,
    wheel=str,
    innovation_mps=float,
    limit_mps=float,
    gate_sigma=float,
)
REFUSALS = (FIX_REFUSED, VELOCITY_REFUSED, WHEEL_REFUSED, WHEEL_SPEED_REFUSED)
"""No news while two directions are tried, of which one is wrong."""
SLIPPING = define(
    "tram.slipping",
    "{key}: a wheel has not fitted the motion for {slipping_s}, limit {limit_s}",
    cause="A wheel slips or slides, or its scale is wrong.",
    cure="if it lasts on dry rail, correct $.wheels.m_per_pulse",
    key=str,
    slipping_s=float,
    limit_s=float,
)
NO_IMU = define(
    "tram.no_imu",
    "{key}: no inertial reading for {silence_s}, limit {limit_s}",
    cause="The IMU is away or silent (health/imu/device), or its stamps are late.",
    cure="look at the device imu",
    key=str,
    silence_s=float,
    limit_s=float,
)
NO_WHEELS = define(
    "tram.no_wheels",
    "{key}: no wheel reading for {silence_s}, limit {limit_s}",
    cause="The vehicle bus is silent (health/odometer/device), or its stamps are late.",
    cure="look at the device odometer",
    key=str,
    silence_s=float,
    limit_s=float,
)
NO_FIX = define(
    "tram.no_fix",
    "{key}: no usable fix for {silence_s}, limit {limit_s}",
    cause="A tunnel or a depot; or the receiver is away, or has no view of the sky.",
    cure="look at the device gnss and its antenna",
    key=str,
    silence_s=float,
    limit_s=float,
)
HEADING_LOST = define(
    "tram.heading_lost",
    "no sensor has told of the motion for {silence_s}, limit {limit_s}; the heading is sought anew",
    cause="Neither inertial nor wheel readings came for so long that the tram may have turned.",
    cure="look at the devices imu and odometer",
    silence_s=float,
    limit_s=float,
)
IMPOSSIBLE_READING = define(
    "tram.impossible_reading",
    "{key}: an inertial reading that cannot be was left out",
    cause="A rate or force that no tram makes, or that is no number.",
    cure="look at the device imu and its mounting",
    key=str,
)
RECEIVER_BOASTS = define(
    "tram.receiver_boasts",
    "{key}: fixes err by {times} times what the receiver states, {stated_m}; they are weighed so",
    cause="The receiver is too sure of itself, or its accuracy comes in a wrong unit. "
    "How far fixes are from the vehicle's way shows it.",
    cure="check what the receiver states; a multiple that stays belongs into its settings",
    key=str,
    times=float,
    stated_m=float,
)
DRAWN_STRAIGHT = define(
    "tram.drawn_straight",
    "{key}: the readings lie on straight lines; they were lost, and are believed as little",
    cause="Samples were lost, and whoever recorded them has drawn lines through the gap. Heading "
    "and speed may change unseen as in a pause.",
    cure="let the logger leave out what it has lost",
    key=str,
)
IMU_STUCK = define(
    "tram.imu_stuck",
    "{key}: {axis} has given {value} for {readings} readings; the IMU is left out",
    cause="A sensor that lives never gives the same number for long: it is stuck, at the end of "
    "its range, or dead. The filter goes on as without an IMU.",
    cure="look at the device imu; power it off and on",
    severity=ERROR,
    key=str,
    axis=str,
    value=float,
    readings=int,
)
IMU_LIVES = define(
    "tram.imu_lives",
    "{key}: all axes of the IMU live again; it is used",
    cause="It was left out as stuck, and its numbers have changed for a second.",
    severity=INFO,
    key=str,
)
WHEEL_DEAD = define(
    "tram.wheel_dead",
    "{key}: the counter of wheel {wheel} has stood for {still_s}, in which the other wheel went "
    "{others_m} and GNSS saw a fast vehicle for {fast_s}; it is left out",
    cause="A sensor or its cable is broken, or its gateway repeats the last value. The filter goes "
    "on as without that wheel.",
    cure="look at the wheel's sensor and its signal in the DBC",
    severity=ERROR,
    key=str,
    wheel=str,
    still_s=float,
    others_m=float,
    fast_s=float,
)
WHEEL_LIVES = define(
    "tram.wheel_lives",
    "{key}: the counter of wheel {wheel} changes again; it is used",
    cause="It was left out as dead.",
    severity=INFO,
    key=str,
    wheel=str,
)
FIXES_FROZEN = define(
    "tram.fixes_frozen",
    "{key}: fixes have stayed at one place for {still_s}, in which the vehicle went {gone_m}, "
    "limit {limit_m}; they are left out",
    cause="The receiver, or whoever hands its fixes on, repeats the last one and calls it valid.",
    cure="look at the receiver; power it off and on",
    severity=ERROR,
    key=str,
    still_s=float,
    gone_m=float,
    limit_m=float,
)
FIXES_JUMPED = define(
    "tram.fixes_jumped",
    "{key}: fixes have been {off_m} off for {lasted_s}, limit {limit_m}, and came there at once; "
    "they are left out",
    cause="No vehicle jumps: the receiver is spoofed, or its fixes come from elsewhere. The filter "
    "goes on without them for as long as it has followed them before, ten minutes at most.",
    cure="look at the receiver's own word on spoofing",
    severity=ERROR,
    key=str,
    off_m=float,
    limit_m=float,
    lasted_s=float,
)
FIXES_BACK = define(
    "tram.fixes_back",
    "{key}: fixes are back where the vehicle is, after {lasted_s}; they are used",
    cause="They had jumped away.",
    severity=INFO,
    key=str,
    lasted_s=float,
)
WHEELS_LIED = define(
    "tram.wheels_lied",
    "the vehicle has moved for {still_s} while no wheel turned; place and heading are sought anew",
    cause="All wheels were dead at a departure, which was taken for a stop.",
    cure="look at the vehicle bus and the wheels' sensors",
    severity=ERROR,
    still_s=float,
)
ASTRAY = define(
    "tram.astray",
    "{key}: a measurement was left out, it is {off_s} off its frame's time, limit {limit_s}",
    cause="Its stamp is wrong, or whoever makes frames does not order them.",
    cure="look at the clock of that device",
    key=str,
    off_s=float,
    limit_s=float,
)
ACCURACY_UNSTATED = define(
    "tram.accuracy_unstated",
    "{key}: a fix without a usable accuracy was taken for one of {taken_m}",
    cause="The receiver states no accuracy (plain NMEA).",
    cure="have it send UBX-NAV-PVT, or NMEA GST",
    key=str,
    taken_m=float,
)
IMPOSSIBLE_VELOCITY = define(
    "tram.impossible_velocity",
    "{key}: a fix's velocity of {speed_mps} was left out, limit {limit_mps}",
    cause="The receiver errs; no rail vehicle of this house is faster.",
    cure="look at the receiver's own velocity",
    key=str,
    speed_mps=float,
    limit_mps=float,
)
ERROR_TAKEN = define(
    "tram.error_taken",
    "{key}: fixes have not fitted the motion for {refused_s}; their error is taken for {error_m}",
    cause="A new multipath, or a receiver that repeats or invents fixes: they are followed no "
    "further than this error lets them.",
    cure="look at the antenna's view of the sky",
    key=str,
    refused_s=float,
    error_m=float,
)
FIRST_FIXES_WRONG = define(
    "tram.first_fixes_wrong",
    "{key}: the first fixes were {away_m} from all that came; the position is taken from these",
    cause="Receivers invent their first fixes when they are switched on in a hall.",
    key=str,
    away_m=float,
)
FILTER_WRONG = define(
    "tram.filter_wrong",
    "{sources} have contradicted the filter alike for {refused_s}; heading ({heading_off_rad}) and "
    "speed ({speed_off_mps}) are taken from them",
    cause="The filter was led astray: an IMU whose errors have changed, a slip that was believed. "
    "What several sources say together is not the fault of each.",
    cure="if it comes again, check $.imu.mounting_deg, $.wheels.m_per_pulse and the IMU",
    sources=str,
    refused_s=float,
    heading_off_rad=float,
    speed_off_mps=float,
)
IMU_CONTRADICTED = define(
    "tram.imu_contradicted",
    "the filter was wrong {times} times within {within_s}; the IMU is left out for {left_out_s}",
    cause="Fixes and wheels agree, and the IMU says something else: it is mounted otherwise than "
    "configured, its units are wrong, or it is broken.",
    cure="check $.imu.mounting_deg and the scales of $.imu",
    severity=ERROR,
    times=int,
    within_s=float,
    left_out_s=float,
)
MOUNTING_WRONG = define(
    "tram.mounting_wrong",
    "{key}: the IMU's case is {off_deg} off how it is configured, limit {limit_deg}; the IMU is "
    "left out",
    cause="Gravity at a stand, or the force of driving against the wheels, comes from elsewhere "
    "than $.imu.mounting_deg says, by more than the filter learns. It goes on with fixes and "
    "wheels.",
    cure="set $.imu.mounting_deg as configuration_check.mounting_tilted or "
    "configuration_check.mounting_turned say",
    severity=ERROR,
    key=str,
    off_deg=float,
    limit_deg=float,
)
POSITION_TAKEN = define(
    "tram.position_taken",
    "{key}: the position was {away_m} from the fixes for {lasted_s}; it is taken from them again",
    cause="The filter was led astray: a long slip, a wrong heading, or fixes that are all wrong.",
    cure="compare est/ekf/location with raw/gnss/location on a map",
    severity=ERROR,
    key=str,
    away_m=float,
    lasted_s=float,
)
NO_HOPE = define(
    "tram.hopeless",
    "the position was taken from the fixes {times} times within {within_s}; the filter begins anew",
    cause="The filter does not know what it does: the configuration or the sensors are wrong.",
    cure="check $.wheels, $.imu.mounting_deg and $.gnss.lever_arm_m",
    severity=ERROR,
    times=int,
    within_s=float,
)
BEGAN_ELSEWHERE = define(
    "tram.began_elsewhere",
    "fixes stay {limit_m} and more from where the ride began; the filter begins anew",
    cause="The first fix of the ride was wrong.",
    severity=ERROR,
    limit_m=float,
)
SET_BACK = define(
    "tram.set_back",
    "time goes on from an instant {back_s} earlier; the filter begins anew",
    cause="A clock was set back, or another ride is replayed.",
    severity=ERROR,
    back_s=float,
)
TIME_BACKWARDS = define(
    "tram.time_backwards",
    "time ran backwards by {back_s}; the frame was left out",
    cause="Somebody has set a clock back, replays another ride, or makes frames twice.",
    cure="see with `tramstream top` who publishes frames",
    back_s=float,
)
