"""What is judged by what number in tuning: each with its unit and reason."""

# the analysis of an experiment
ENOUGH_S = 25.0  # of an experiment, for the models in closed loop: more takes longer than it tells

# what is announced
JUMP = 0.1  # of limits.velocity: an axis that is slower is not stopped

# identification
LEAST_SPEED_RATIO = 0.01  # of the highest speed: below, what holds the axis is no friction to a static model
LOWPASS_HZ, LOWPASS_RATIO = 100.0, 0.4  # of the position, and the most of it that a sampling rate allows
ROWS_HZ = 100.0  # of a regression with static models
# Of the low-pass: the time before and after a row in which the axis has to slide. The low-pass mixes half a period with
# the row; for longer, the friction of an axis that has broken away still follows its velocity: it lags by its level
# over stiffness and speed, -lag s'(v) a, which looks like inertia where the curve falls.
SLIDING_PERIODS = 2.0
COUNT_PERIODS = 2.0  # of the low-pass: the longest time for a count from which a speed is known
NOISY_RATIO = 0.1  # of the velocity
TURNING = 5.0  # times level over stiffness of presliding: there a bristle has turned but for 1.3 %
MOST_TURNING = 0.02  # of the travel

# fits in closed loop
OBSERVER_RATE = 4.0  # of the observer, over the gain of the position loop
EVALUATIONS = 15
TOLERANCE = 1e-3  # of a change, relative, that ends a search
# Of a parameter, for its derivative, in one search after the other. Where sticks begin and end, the error has steps:
# long differences see over them.
SEARCH_STEPS = (0.15, 0.1, 0.05, 0.02)
PROBES = (-0.35, -0.15, 0.15, 0.35)  # of a coordinate, at the end of a search, which may be a valley of these steps
BETTER = 0.98  # of the cost there: a lower one is worth another search
LAST_STEPS = SEARCH_STEPS[-2:]  # of that search
DAMPING = 0.01  # of columns of length 1: a block that alone shows a parameter is not extrapolated without bound
LEAST_SCALE = 0.01  # of a coordinate, of its range
SETTLED_S = 0.5  # until the loops have found their torque: errors count after it
LARGE_ERROR = 3.0  # times the usual error: larger ones count less
LEAST_ERROR = 0.5  # count: smaller differences are those of the encoder
FAILED_ERROR = 1e3  # counts, of a simulation without a result
CLOSED_LOOP_ROWS_HZ = 200.0  # of what standard errors are computed from

# torque over the position
AS_LARGE = 0.3  # of the friction level: root mean square of harmonics without which friction is not identified either

# a joint of an arm
ARM_OFF = 0.3  # of the larger one: a weight or an inertia that differs more contradicts the arm's file, the weight
ARM_NOTED = 0.5  # only if it differs by more than this part of the friction level, too
ARM_DOUBT = 0.1  # of the friction level: standard error up to which an offset is told from the weight
ARM_LIGHT = 0.05  # of the friction level: no weight that an offset could be
ARM_SURE = 3.0  # standard errors of an offset that is told from the weight

# checks of a recorded experiment
SPEED_WINDOW_S = 0.02  # over which a speed is averaged, so that single counts of an encoder do not matter
TOO_FAST = 2.0  # times the highest speed of the experiment

# other gains in the trial
GAIN_DOUBT = 2.0  # the first higher gain keeps so many standard deviations of the torque away from 1
GAIN_DIFFERENCE = 0.01  # difference between two gains
GAIN_STEP = 0.1  # step of a lower gain
MOST_GAINS = 2  # further gains
CLIPPED = 0.01  # of the rows; fewer do not matter
NEAR_LIMIT = 1.0 - 1e-9  # of the limit

# runs
REST_S = 0.5  # after a motion
TRIAL_HZ = 0.5  # of the trial motion of an axis without a periodic trajectory
TRIAL_TRAVEL, TRIAL_SPEED = 0.5, 0.3  # of travel and velocity of the experiment

# motions of the rehearsal
START_S = 2.0  # for the axis to start and the compensation to fade in

# the rehearsal
SWING = 0.999  # factor left on the gain by the guard against limit cycles: below, the model swings
MOST_CANDIDATES = 10  # of an identification
FINALISTS = 5  # that are simulated on all plausible frictions; the others on the likeliest one
MOST_AXES = 4  # plausible frictions
LEAST_WEIGHT = 0.02  # of the likeliest: a less likely friction is not simulated
DOUBTFUL_WEIGHT = 0.2  # of the frictions on which a candidate swings
SWINGING_REDUCTION = 0.5  # for which a motion counts in which it swings
LARGEST_REDUCTION = 20.0  # more is beyond what a simulation can tell
MOST_TRIED = 3  # on the drive
TOLD_APART = 1.3  # ratio of scores: smaller ones say nothing

# the end of an experiment
FIRST_S = 15.0  # the first two parts: enough for all sweeps, and two of them for a comparison
DIFFERENCE = 0.01  # of the following error: what is unknown may add as much to it
LEAST_LEFT = 0.05  # of the friction, by any compensator: its torque is late, and its model not quite the axis
NAMED = 0.1  # of the variance: parameters with less of it are not named

# torque lag
CLEAR = 3.0  # standard errors by which a lag is above zero, or a lag or torque ratio differs from a stated one
GAIN_ERROR = 0.2  # of the command in the reported torque: more, and it is not the torque that was commanded
AT_LIMIT = 0.9  # of the longest lag that is looked for
SLOWEST_LOOP_HZ = 100.0  # bandwidth of a current loop: what is slower is rather a filter of the reported torque

# reported over commanded torque
NOTEWORTHY = 0.02  # a smaller difference is no error of the compensation that could be seen
VAGUE_RATIO = 0.1  # standard error of a ratio that says nothing
LEAST_RATIO, MOST_RATIO = 0.5, 2.0  # beyond, the drive does not apply the command, or reports something else

# the trial
LEAST_REDUCTION = 1.05  # of the RMS; smaller ones may be chance
RMS_COUNTS = 0.3  # of the encoder: the RMS of its own rounding

# motions of the trial
PAUSE_S = 0.3  # at rest after each motion
STEADY_S, LEAST_PERIODS = 4.0, 2  # of the own motion that count
SLOW_RATIO = 0.1  # of the own speed
SMALL_RATIO, TINY_RATIO = 0.1, 0.01  # of the own amplitude
SLOW_HZ, SMALL_HZ, FAST_HZ = 0.25, 1.0, (0.5, 3.0)  # least frequencies, so that each takes some seconds
SMALL_S, FAST_S = 2.0, 1.5  # least length, at full speed
STROKE_S, BETWEEN_STROKES_S = 1.0, 1.0
TRAVEL = 0.85  # of the experiment's: an axis that follows overshoots a little, as in the experiment
ACCELERATION = 0.6  # of the experiment's: the ramps take the rest
FAST_ACCELERATION = 0.9  # with a ramp of half a period or more, which adds nothing to the acceleration of the sine
FASTER = 1.1  # times the own speed: else the own motion is the fastest
