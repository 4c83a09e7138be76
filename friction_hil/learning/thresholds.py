"""What is judged by what number in learning: each with its unit and reason."""

import math

import numpy as np

# a model in another form
MAXWELL_ELEMENTS = 4  # of a Maxwell-slip model: each further one adds a stiffness that the motion has to show
BREAKAWAY_RATIO = 0.5  # where the family had none: in the middle of what is possible
VISCOUS_OF_LEVEL = 0.02  # of the level at the top speed, where there is none: one of zero could never be learned
STRIBECK_OF_SPEED = 0.05  # of the top speed: a hump that is not known is beside the speeds at which the level is

# coordinates of the parameters
DEFAULT_ERROR = 0.3  # relative standard error of a parameter for which the model file has none
MOST_ERROR = 1.0  # the same, at most: of what is less certain a logarithm says nothing
LEAST_BELOW = 1e-6  # of an upper bound: a parameter stays so far below
LEAST_ERROR = 0.01  # a standard error of identification does not contain what temperature has changed since

# the estimate
INERTIA_ERROR = 0.1  # standard deviation of its relative error
STATIC_ERROR = 0.1  # the same of offset and gravity together, in friction levels
DELAY_PERIODS = 0.5  # the same of the age of the torque
MECHANICS_DRIFT = 0.5  # of these standard deviations: what a minute adds
FARTHEST = math.log(5.0)  # of a coordinate of the friction
EVALUATIONS = 12  # of each search, which begins near its end
# More as long as the residual falls below so much of the last.
REWEIGHTINGS, MOST_REWEIGHTINGS, ESTIMATE_SETTLED = 2, 6, 0.8
NEAR_S = 0.02  # over which the size of the residual is judged
EQUAL_PART = 0.5  # of the rows, those with the smallest residuals, have equal weights
CORRELATED_S = 0.5  # longest correlation of the residual that is looked for
QUANTUM = 1e-3  # of the friction level: a residual below is taken to be of that size
SHOWN = 0.3  # of its first standard deviation: a parameter that is known so much better is shown by the records
TIMING = 1.0  # of the change of friction within a period: what is not known of when in a period it happened
DEVIATIONS = 3.0  # of what was known at first: farther no estimate goes
SURPRISE = 12.0  # a change that drift does not explain
# Times the residual of the last record, and this part of the level: is it a change?.
CONTRADICTED, CONTRADICTED_LEVEL = 1.5, 0.005
LESS_RESIDUAL = 0.7  # times that residual without what was known: it was wrong

# other families
FAMILY_WINDOWS = 8  # of the same motion, one after the other, that a family is judged by
FAMILY_SETTLED = 4  # windows of a motion in which the present family alone learns
FAMILY_BEGUN = 2  # windows that another one has learned from before it is judged
FAMILY_EXPLAINED = 0.1  # of the mean square of what the present family leaves: a family that explains less is not tried
FAMILY_EVIDENT = 3.0  # standard errors of the windows
FEW_WINDOWS, OBVIOUS = 3, 0.5  # windows in each of which so much was explained, that are enough
FAMILY_RARELY = 100  # windows, ten minutes of motion, before another family is looked for
FAMILY_UNDECIDED = 10  # windows, after a trial without a verdict, or before another family's trial
MAP_DEFLECTIONS = np.geomspace(0.1, 1e-5, 9)  # of the travel: break-away of a map that has no presliding

# missed periods
MOST_FILLED, MOST_DISTURBED = 0.1, 0.75  # parts of a tick

# the judgement of a trial
ALIKE = 0.15  # relative difference of two motions that count as the same work
HELPS = 0.98  # errors by so much lower count as help
PEAK_GROWS, MOST_PEAK_GROWS = 1.1, 1.5  # and the peak must not grow by more; more where the errors are far lower
# Spans, s, and how many times the largest error before is harm there. Over a longer one less is left to chance.
HARM_SPANS_S, HARMS = (0.5, 1.0, 2.0, 4.0), (1.5, 1.2, 1.15, 1.1)
EFFORT_GROWS, CLEARLY_LOWER = 1.5, 0.8  # more effort than that takes errors that are clearly lower

# the torque of a residual layer
CURVE_END = 2.0  # times the last distance of a layer: nothing is left of its torque

# trials
SETTLING_TICKS = 3  # beyond the fade: the first strokes after a change are of neither side
UNJUDGED_TICKS = 1  # errors may be due to the change itself, in the midst of a reversal
MISLED_TICKS = 2  # one after the other: one may be that of a reversal
FIRST_PART, FIRST_TICKS = 1.0 / 3.0, 4  # part of a change that is tried first: a wrong one does a ninth of the harm
DRIFT = 0.1  # relative standard deviation of what temperature and wear change within a minute
WORTH = 0.004  # of the friction level: root mean square torque, or change of it, that is worth a trial
# The same: change since a trial that was taken back, after which the next one does not wait.
OTHER_FRICTION_LEVEL = 0.03
FALLS = 0.02  # decrease of the friction since the last change of parameters, beyond which it counts as falling
GAIN_WORTH = 0.01  # change of the gain that is worth a trial
LESS_GAIN = 0.05  # step of a lower gain
GAIN_DOUBT = 2.0  # the gain keeps so many standard deviations of the torque away from 1
# Windows without a trial after one taken back, the next one longer.
TRIAL_FIRST_PAUSE, LONGER, TRIAL_LONGEST_PAUSE = 1, 3, 40
LEAST_COUNTS = 1.0  # of the encoder: nobody can tell if a smaller error becomes smaller
STOPPED_TICKS = 40  # until learning goes on: ten seconds
WORSE_ERROR = 1.2  # times the error at the last trial: another one does not wait any longer
MISLED, MISLED_LEVEL = 1.5, 0.01  # times what the model file leaves unexplained, and this part of the level

# kinds of motion
WINDOW_TICKS = 24  # of motion, before it counts as a kind; the longest span
SPANS_TICKS = (1, 2, 4, 8, 16, WINDOW_TICKS)  # a large difference shows in the shortest, a small one in the longest
RECOGNISED_TICKS = 4  # of motion within what is known of a kind
MOTION_PARTS = 10  # of a tick: spans begin at each, so that their ranges do not depend on where ticks begin in a period
SPAN_MARGIN = 2  # of parts, by which a span of a motion may be longer or shorter
REMEMBERED_TICKS = 54  # of both sides of a comparison
MOST_KINDS = 8  # of motion, that are remembered
GAIN_LIMITED, OTHER_FRICTION = 20, 0.1  # proposals, and relative change of the friction: so long a gain is limited

# records that are not of the axis as it was
WARM_TICKS = 4  # before those that count: they bring the state of the model to where it was
FROZEN_TICKS = 3  # in which a torque feedback that never changes is frozen
FROZEN_LEVEL = 0.2  # the compensation changed by so much meanwhile, the torque feedback not at all
# times the largest change of the following error within a period before, as long as little of it has been seen, later
FIRST_GLITCH, GLITCH, GLITCH_COUNTS = 8.0, 4.0, 16.0
SPAN_TICKS, LEAST_ALIKE = 3, 3  # of a comparison of following errors; spans of the past that it needs
OTHERWISE, OTHERWISE_COUNTS = 3.0, 4.0  # times the errors of the same motion before
ODD_TICKS = 2  # one may be that of a reversal
ODD = 2.0  # times what was left unexplained before
ODD_LEVEL = 0.05  # and this part of the friction level at least
LEAST_MOVING = 0.25  # part of a tick; a shorter motion says too little
UNFILTERED = 20  # last rows of a record, which its filters do not reach

# notices
MOST_NAMED, NAMED_CHANGE = 3, 0.005  # parameters in a notice, and their least relative change

# parameters of an earlier run
PROVEN_LONGEST_S = 7.0 * 86400.0  # older ones are stale
PROVEN_WARMEST_K = 10.0  # and those of another temperature

# the record
TICK_S = 0.25  # of which the rows are looked at together
MORE_LEFT = 2.0  # times what is left of the friction now: the most that a truer model may leave with its gain
EXPLAINS = 0.8  # times the unexplained torque of former parameters
STEADY_DRIFT, MOST_DRIFTED = 0.02, 1.25  # change of what the former compensation leaves within a trial: none, and most

# the residual layer
LAYER_SHARE = 0.2  # of the friction level: the torque of a layer is at most so much
MOST_HARMONICS = 4  # harmonics
LAYER_HELD = 1.0  # of what rows show of a coordinate: by so much it is held where it is
LAYER_CLEAR = 0.4  # of the mean square of what the model leaves: groups beside ripple that explain less are not tried
LAYER_PARTS = 2  # of a window, each explained by what the others and the past show
LAYER_SPENT = 2  # windows in which a layer explained nothing, one after the other: it is switched off
LAYER_FIRST_PAUSE, LAYER_LONGEST_PAUSE = 2, 40  # windows without a trial, after one that was no gain
SEARCHED_ROWS = 2000  # of a window; the search takes most of the time
LOAD_VARIED = 0.05  # of the friction level: scatter of the load torque from which on its effect is looked for
LAYER_DISTANCES = tuple(2.0**k for k in range(-3, 6))  # in distances over which the torque builds up after a reversal
LAYER_SPEEDS = tuple(2.0**k for k in range(-6, 1))  # in top speeds
DISTANCE_OF_TRAVEL = 1e-3  # such a distance where the model has none
LAYER_MOVING = 0.01  # of the top speed: slower rows are at rest, where friction is whatever holds the axis
SAME_ROWS = 20.0  # rows that show no more than one, because what a model leaves is correlated
LAYER_EXPLAINED = 0.1  # of the mean square of what the model leaves: a layer that explains less is not worth a trial
STRETCHES = 12  # of a window, that count as repeated records
LAYER_REMEMBERED_S = 60.0  # time constant of forgetting
LAYER_EVIDENT = 3.0  # standard errors by which the explained part exceeds chance
AT_TIMES = 1.5  # the same of what a slow motion shows at a few reversals only
AMPLITUDE_EXPECTED = 0.1  # of the friction level: standard deviation of an amplitude before anything was learned
CURVE_SMOOTH = 0.05  # of the friction level: the same of the change from one place of a curve to the next
DIRECTIONS_DIFFERENT = 0.015  # and of that of half the difference between both directions
