"""What is judged by what number in identification: each with its unit and reason."""

import math

import numpy as np

# the choice of a fit
EXACT = 1e-3  # of the measured torque: smaller errors do not matter
NEGLIGIBLE = 0.014  # of the friction: beside the tenth that a gain of 0.9 leaves, it makes a difference of 1 %
ABSENT = 1e-3  # of its upper bound: a Coulomb level below is at the lower one
SERIES = 20  # values: fewer do not show how they are correlated, as those of groups of recordings
CHOICE_FAR = 2.0  # standard errors: a fit that is worse by more is not plausible

# two masses, over the time
TWO_MASSES_GRID = 12  # stiffnesses to start from
FINER = 3  # of them
SEARCHES = 2  # of the best starts, to their ends
PROMISING = 0.9  # of the residual of one mass, after a short search
TWO_MASSES_SHARES = (0.04, 0.09, 0.18, 0.35, 0.6)  # of the load in the inertia
TWO_MASSES_FIRST_EVALUATIONS, TWO_MASSES_EVALUATIONS = 6, 25  # of a search for each share, and of one to its end
TWO_MASSES_LEAST_RATIO, MOST_RATIO = 1e-3, 1.5  # damping ratio at the anti-resonance
LEAST_HZ = 2.0  # anti-resonance: a slower one is not told from friction and gravity
STROKES = (1e-5, 1e-4, 1e-3, 1e-2)  # of the bristle, of the travel
SHORT_STROKES = (math.log(1e-5), math.log(3e-4))  # a long one would take the place of the coupling
TWO_MASSES_LEAST_STROKE, MOST_STROKE = 1e-7, 0.1  # of the bristle, of the travel: bounds of the search
TWO_MASSES_STEP = 0.25  # of a step times the natural frequency: the frequency is right to 0.3 %

# other joints of an arm
JOINTS_TOLD = 0.3  # of the residual's variance on blocks held out, from which on other joints are named
NAMED = 0.1  # of the same, for a joint by itself
JOINTS_SAME = 0.99  # correlation of two positions of the same axis, such as the measured one and its demand
JOINTS_BETTER = 0.5  # ratio of errors below which another torque column fits the motion clearly better
MOST = 32  # other joints that are looked at

# loops of a drive
LEAST_EXPLAINED = 0.9  # part of the torque's energy that the law has to explain
LOWEST_HZ = 0.5  # of the band-pass: below, the integral drifts
LOOPS_BANDS = (0.1, 0.05, 0.025)  # upper edge of the band-pass over the sampling rate
LAGS_S = (0.0, *np.geomspace(1e-4, 5e-3, 24).tolist())  # of the torque, that are tried
LOOPS_LEAST_S = 5.0  # of a recording without a gap, of which the filters take two
LOOPS_EDGE_S = 1.0  # the filters settle
FEEDFORWARD_ERROR = 0.05  # of a full feed-forward of the velocity: less cannot be told from it

# periodic errors of the encoder
MOST_LOOKED_AT = 6  # orders, of torque or encoder
MOST_ORDERS = 2000  # that are looked at
ENCODER_EVIDENT = 12.0  # least Wald statistic beyond that of the largest of N orders of noise, 2 ln N
# Of what both ripples of an order explain: friction that varies over the travel looks like less.
ENCODER_LEAST_SHARE = 0.3
ENCODER_CLEAR = 8.0  # standard errors, because the speed of a stroke depends on the position, too
ENCODER_BAND = 0.8  # of the low-pass: faster rows of an order are not looked at
ENCODER_LEAST_ROWS = 200  # that pass an order slowly enough for the low-pass
LEAST_PERIODS = 1.0  # over the travel

# records at the resolution of the encoder
LEAST_S = 5.0  # of a segment; filters and states settle in its first and last second
SLOWEST_SWING_HZ = 8.0  # of an oscillation that shows presliding: below it the axis travels
FASTEST_SWING_HZ = 80.0  # the same: above it is mostly the encoder's noise
LEAST_FRACTION = 0.05  # of the time
FINE_CLEAR = 100.0  # times the noise power of the encoder
FIRST_BAND_HZ = 40.0  # frequencies below are kept entirely
LAST_BAND_RATIO = 0.42  # of the sampling rate: highest frequency that is kept
NOISE_FACTOR = 2.0  # the noise power of few samples is often twice its mean
STEPS_HZ = 12000.0  # of the model
COARSE_STEPS_HZ = 4000.0  # of a search that is not the last one
ROWS_HZ = 200.0  # of the regression
RESIDUAL_HZ, RESIDUAL_WIDTH_HZ = 80.0, 60.0  # low-pass of the residual, and width of its transition
FINE_EDGE_S = 1.0  # at either end of a segment, in which filters and states settle

# the fit of a candidate
FIRST_EVALUATIONS = 5  # from each start; the search continues from the best one
FIT_EVALUATIONS = 60  # of the full search

# the frequency response
LEAST_COHERENCE = 0.8  # of a line that is used: below, a fifth of the power is no linear response
LEAST_WINDOWS = 8  # of fewer, a jackknife does not know the scatter
WINDOWS_S = (4.0, 2.0, 1.0, 0.5, 0.25)  # lengths, the longest first of which there are enough
LEAST_SPEED_RATIO = 0.02  # of the top speed: what is slower does not slide
RESPONSE_TOP_RATIO = 0.4  # of the sampling rate: highest line
REACH, DEGREE = 3, 2  # lines to either side of a line, and degree of numerators and leakage over them
LEAST_LINES = 8  # that are coherent: of fewer no form is told

# Stribeck humps
LEAST_DIP = 0.02  # of the top speed: a narrower dip below the Coulomb level is an error of presliding
HUMP_HEIGHT, HUMP_WIDTH = 1.3, 0.05  # of a search for one, in Coulomb levels and top speeds

# families
# Times the error of the best family: with parameters for each direction a family is no candidate either.
FAMILIES_FAR = 3.0
EXTENDED = 2  # families that are tried with further modifiers
FAMILIES_ROUNDS = 3  # of adding one more modifier

# what the data determine
COLLINEAR = 0.98  # correlation above which two parameters are reported as collinear
VAGUE = 0.5  # standard error over value above which a value is not determined
REPORTED_CORRELATION = 0.9  # of two parameters, from which on it is reported
LEAST_COMPONENT = 0.1  # of a parameter in an undetermined direction, for it to belong to the collinear group

# friction per load
LOAD_CLEAR = 4.0  # standard errors
FELT = 0.03  # of the friction: a smaller part is no dependence
SHOWN = 0.05  # a factor that is below this for sure is none
SURE = 2.0  # standard errors
LOAD_FORM = 0.1  # of the factor: no gear loses one part of all torques, in both directions, to better than that
LOAD_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the load in inertia and friction
WORSE = 3.0  # standard errors by which a pair has to explain less to be excluded
INDEPENDENT = 0.02  # of the energy of the load's column, outside all others

# the dynamics of an arm
ARM_PRIOR = 0.25  # part by which inertial parameters of a file are wrong, one standard deviation
ARM_LOAD = 0.05  # standard error of friction per load beyond which a log does not determine it, unless it is clear
ARM_STILL = 50.0  # counts of its encoder: a joint with less travel is held still,
ARM_STILL_RAD, ARM_STILL_M = 0.05, 0.005  # or less than this: its loop gives way, and its gear twists
ARM_FOLDS = 5
ARM_WORSE = 1.05  # times the error of a joint alone, from which on the arm is told to explain it less well
ARM_CONTRADICTED = 1.5  # times what files are off by, from which on a file does not go with the log

# the position of the load
LOAD_SIDE_BAND = 0.08  # of the sampling rate
STRETCH_S = 0.25  # over which residuals are taken to be correlated
LOAD_SIDE_CLEAR = 4.0  # standard errors
LEAST_COUNTS = 2.0  # of the encoders, in a backlash
LEAST_WIDTH = 0.02  # of the range of the twist: less is not told from a spring that is not quite linear
LOAD_SIDE_LEAST_ROWS = 200  # in which either side moves
LEAST_KNOWN = 0.9  # of the rows
LEAST_SPEED = 0.05  # of the RMS of a velocity: slower, a side may stand still
WIDEST = 0.95  # of the range of the twist
WIDTHS = (0.02, 0.1, 0.3, 0.6)  # of the range of the twist, to start from

# quantities behind the motor
LIKE = 3.0  # a stiffness within this factor of another is like it
MECHANICS_FORM = 0.02  # of each value: no axis is two masses with Coulomb friction to better than a few per cent
PULL = 0.2  # of the torque: a constant one from which on it may hold a load against one side of a gap

# the motion of the motor
MOTION_TOP_RATIO = 0.15  # of the sampling rate: highest frequency that is compared
MOTION_LEAST_RATIO = 0.02  # of the sampling rate: the lowest cut-off that is worth a comparison
DIRECTION_RATIO = 0.45  # of the sampling rate: low-pass of the velocity that gives the direction
ANTIALIAS = 0.4  # of the sampling rate
MOTION_NOISE = 0.1  # of the torque: most of what the counts of the encoder make of an acceleration
NOISY_SPEED = 0.02  # of the velocity's RMS
MOTION_STEP = 0.85  # from one cut-off that is tried to the next
STUCK_COUNTS, STUCK_ROWS = 3.5, 5  # an axis that moves by less in so many rows stands still
STUCK_RATIO = 1e-3  # the same of the usual motion, if the position is not quantised
SETTLED_S = 0.3  # after the start, where the twist of the coupling is not known
MOTION_ROWS_PER_PERIOD = 2.5  # of the cut-off frequency

# other axes that move
BESIDE_TOLD = 0.1  # of the residual's variance on blocks held out, beyond what the axis's own motion explains

# the plainest axis
FRACTIONS = (0.01, 0.02, 0.05, 0.1, 0.2)  # of the top speed: least speeds to try
TOP = 0.98  # quantile of the speed that is taken for the top speed
SPOILT = 1.1  # times the error with the best least speed, above which slow rows spoil the fit
PLAIN_SAME = 1.02  # times the same, below which a lower least speed is as good
PLAIN_LEAST_SHARE = 0.1  # of the rows must count

# checks of a result
NOTHING = 0.95  # of the error of a constant torque: a model with a larger error explains nothing
POOR = 0.5  # of the same: a model with a larger error explains less than three quarters of the variance
GOOD = 0.1  # relative error below which no cause is looked for
CLEARLY = 0.8  # ratio of two errors below which the smaller one is no coincidence
NO_FRICTION = 1e-3  # of the measured torque
PLAUSIBILITY_MOVING = 0.05  # of the highest speed
ONE_WAY = 0.02  # of the moving rows: fewer in the other direction determine nothing there
SPEEDS = 50  # at which a model is looked at for friction

# what is held out
BLOCKS = 6  # of time or rows, each held out in turn
SPEED_GROUPS = 4  # of strokes, each held out in turn
HELD_OUT_LEAST_STROKE = 10  # rows
RECORDINGS_AS_BLOCKS = 4  # with this many recordings or more, each is a block
STRETCHES = 60  # of time, over which the errors of two fits are compared
LEAST_STRETCH = 8  # rows
ALIKE = 1.5  # ratio of the top speeds of strokes, below which they are one kind of motion
MARGIN = 5  # rows on either side of a block, which share samples with it through the filters

# the refinement
REPLICAS = 8  # simulated experiments
REWEIGHTINGS = 2  # of rows; a further one hardly changes the weights
REFINED_EVALUATIONS = 20  # the search has begun already, on fewer steps of the model
FURTHER_EVALUATIONS = 10  # after each reweighting
WEIGHT_S = 0.25  # window of the local residual
EQUAL_FRACTION = 0.25  # of the rows, those with the smallest residuals, have equal weights
# Variance of a subtracted shift, relative to its square: it depends on the fitted model.
SHIFT_DOUBT = 1.0 / 8.0

# the regression
# Viscous friction that bends down must not change its sign up to so many times the top speed of the data.
BENDING_SPEEDS = 3.0
LONGEST_STEP = 2.0  # of a logarithm: the parameter changes by a factor of 7 at most
SHORT_STEP = 0.03  # relative change of a parameter for which the torque follows its gradient
REFIT_DAMPING = 0.1  # of columns of length 1
REFIT_EVALUATIONS = 4  # of a search from a fit to all rows
REGRESSION_ROUNDS = 4  # of reweighting
ROBUST_DEVIATIONS = 3.0  # beyond which a residual counts less

# two masses, over the frequency
RESONANCE_STARTS = 10  # of the anti-resonance, over the band
RESONANCE_EVIDENT = 30.0  # times the variance of the residual: fall of the weighted sum of squares by three parameters
LEAST_LOAD = 0.02  # of the sum of the inertias
EDGE = 1.15  # the resonance lies so far below the end of the band, or it is a guess
LEAST_DAMPING, MOST_DAMPING = 1e-4, 0.7  # damping ratio: outside, nothing swings, or no axis swings so
RESONANCE_FALL = 0.5  # of the misfit of one mass: bristles and losses of a gear bend the response of a rigid axis, too
MOST_MISFIT = 0.3  # relative deviation from the response: more is another form
LEAST_USED = 0.5  # of the lines between the first and the last used one: else harmonics of something, no response
NEAR_MEAN = 0.15  # of a period between the delay of a torque and that of a mean
RESONANCE_BANDS = 16  # over which a mismatch is alike, evenly spaced on a logarithmic scale
BETWEEN_LINES = 0.01  # of the distance of two lines: error of a frequency by what the polynomials leave out
LEAST_ERROR = 1e-3  # of a line: an interpolated, short or noiseless window is no better

# scales of the data
DEFLECTIONS = 12  # number of deflections tried
SCALES_VELOCITIES = 10  # number of Stribeck velocities tried
LEAST_LEVEL = 1e-3  # of the measured torque: smallest level, so that searches have a scale even without friction
SPREAD = (1e-6, 0.1)  # of the travel: range of deflections tried
SLIDING = 3.0  # presliding deflections after which the axis slides
SCALES_LEAST_SHARE = 0.01  # of the time: the axis slides more slowly than the least sliding speed for as long
LARGEST = 0.999  # quantile
SCALES_MOVING = 1e-3  # of the top speed: the axis moves if it is faster

# the search of several candidates
SCREENING_STARTS = 2  # suggested by the scales, besides that of the base
HUMP_WIDTHS = (0.4, 0.7)  # between the slowest sliding and the top speed, as a share of the logarithm
SCREENING_ROUNDS = ((10, 2.5), (25, 1.4))  # evaluations, and the ratio of errors above which a candidate ends
SIGNIFICANT = 3.0  # standard errors by which it must be worse

# one mass or two
TORQUE_FIT_BETTER = 3.0  # standard errors by which two masses must fit better than one
FALL = 0.8  # of the residual of the simpler form: one mass, or no gap
TORQUE_FIT_CLEAR = 4.0  # standard errors of the inertia of the load, and of the backlash
TORQUE_FIT_LEAST_SHARE = 0.03  # of either mass in the inertia
MOST_DAMPED = 0.4  # damping ratio at the anti-resonance: beyond, nothing swings
TORQUE_FIT_NOISE = 1.3  # times the noise of torque and counts: a fit with such a residual cannot be improved
NARROW = 0.6  # of the band: a fit to it says how far the result depends on what is compared
LEAST_FREE = 1e-3  # of the time in the gap
MOST_ROWS = 16_000  # of all records
PARTS, LEAST_PART_S = 4, 1.5  # of a long record that are used, and the least length of one

# the lag of the torque
HIGHPASS = 0.02  # of the sampling rate: slower changes belong to gravity, friction and integral parts
POSITIONS, LAG_VELOCITIES = 3, 2  # samples that the loops of the drive may use
DEMANDS = (-1, 0, 1, 2, 3, 4)  # samples of the demand: it is sent ahead of time and interpolated
LONGEST = 3.0  # periods; the response to a command has to end within the samples that are followed
EDGE_PERIODS = 100  # in which the high-pass forgets what was before a run, or a gap in it
LAG_FEWEST_ROWS = 1000  # of all recordings
LAG_GRID, LAG_ROUNDS = 301, 5  # lags on a grid, and grids, each narrower than the one before
KEPT = 12.0  # logarithm of the likelihood ratio beyond which a lag is ruled out
ENOUGH_INSIDE = 60  # values of the grid that are not ruled out
LAG_CORRELATED = 30  # samples
UPPER = 0.95  # probability that the lag is below its upper limit

# the scale of the torque
RATIO_BAND = 0.02  # of the sampling rate
RATIO_ROWS_PER_PERIOD = 8  # of the fastest oscillation of the band: the others only repeat them
RATIO_FEWEST_ROWS = 100  # that count, of all recordings
RATIO_CORRELATED = 40  # rows
LEAST_OWN = 1e-3  # fraction of the command that must not be explained by what the loops are given

# the age of the torque
TRIED = 2  # families of friction models
AS_GOOD = 1.1  # times the smallest mean square: a family that fits so well has to agree
FIRST_PERIODS = 0.75  # delay that is assumed first: above the true one, so that no damping ends at its bound of zero
EARLIEST, LATEST = -0.5, 5.0  # periods
STEPS = 4  # of the delay, at most
SETTLED_PERIODS = 0.01  # a smaller step ends the search
TIMING_EVALUATIONS = 8  # of each search
TIMING_REPLICAS = 4  # simulated experiments
TIMING_CLEAR = 3.0  # standard errors
NEAR_PERIODS = 0.15  # deviation from half a period that is none
LATE_PERIODS = 0.75  # from which on a delay is longer than that of a mean
VAGUE_PERIODS = 0.1  # larger standard errors tell nothing
MOST_EXTRAPOLATED = 2.0  # of a first step, by those that would follow

# friction of the joints of an arm
ARM_MOST_DECIMATION = 5  # behind a low-pass at a tenth of the sampling rate: more would lose what it passes
ARM_FOLD_STEPS = 4  # of the search, from the parameters of all rows
ARM_MOST_ROWS = 20_000  # of the regression, whose matrices are of rows, joints and parameters
ARM_MIXED_PERIODS = 1.5  # of the low-pass: time about a reversal that it mixes with it
ARM_LEAST_ROWS = 50  # in which a joint slides
ARM_POSITIONS = 500  # at which the inertia matrix is looked at
ARM_RANK = 1e-8  # of the largest singular value
ARM_NOISE_RATIO = 0.05  # of the acceleration, that counts may make: an inertia becomes too small by the square of it
ARM_LEAST_LOWPASS, ARM_LOWPASS_STEP = 0.02, 0.85  # of the sampling rate; of the cut-off
ARM_ROUNDS = 3  # of leaving out what does not show
ARM_SLOW = 0.03  # of the top speed: slower rows do not count

# the search for all joints of an arm together
ARM_SEARCH_STEPS = 12  # of the search; it ends earlier
ARM_NEAR = 1e-6  # change of the torque relative to its noise
ARM_HUBER = 2.0  # standard deviations from which a residual counts less

# candidates
PENDULUM_TRAVEL = 0.3  # rad: over a smaller range sine and cosine look like a straight line
LARGE_OFFSET = 0.5  # of the friction level: a larger offset cannot be a difference between the two directions
LOAD_ROUNDS = 3  # alternating fits of gravity, which is the load, and of the friction that grows with it

# rows of a regression
STEADY_RATIO = 0.02  # of the top speed: if the speed changes by less, the end of a segment is steady
CUT_STEP, LEAST_CUT = 0.8, 0.1  # of the low-pass, for the acceleration alone
MIXED_PERIODS = 0.5  # of a low-pass: the time before and after a row that it mixes with the row

# modifiers to try
MODIFIED_LEAST_LOAD = 0.1  # of the friction level: a smaller variation of the load does not show
LEAST_WARMING = 3.0  # K: smallest range of temperatures

# modifiers of refined fits
REFINED_BASES = 2  # families that are tried with modifiers
REFINED_ROUNDS = 2  # of refinement: what one shows may hide behind the other
REFINED_CLEAR, REFINED_LEAST_OFFSET = 3.0, 0.03  # standard errors and part of the level: an offset of an asymmetry

# orders of ripple
RIPPLE_LEAST_PERIODS = 1.0  # over the travel
RIPPLE_MOST_PERIODS = 300.0  # over the travel
RIPPLE_LEAST_INDEPENDENT = 0.01  # of a harmonic's energy outside the span of the fit: the axis stays near one position
RIPPLE_LEAST_SHARE = 0.01  # of the energy of the residual without harmonics: less is not worth two parameters
RIPPLE_ROWS_PER_PERIOD = 4.0  # fewer are filtered out, or look like another order
RIPPLE_STRETCH_ROWS = 100  # over which residuals are taken to be correlated
RIPPLE_EVIDENT = 12.0  # least Wald statistic beyond that of the largest of N harmonics of noise, 2 ln N
RIPPLE_CONTRADICTION = 5.0  # standard errors of the order between it and a whole number
RIPPLE_POLISHES = 3  # of all orders, each after another one has changed

# where an axis slides
SLIDING_BAND = 0.2  # of the sampling rate, at most
SLIDING_LEAST_ROWS = 200  # in which it slides
SLIDING_KNOTS = 7  # of the curve, over the speeds
SLIDING_SLOW = 0.05  # of the highest speed: below it, the bristles may still be turning after a reversal
TURNED_S = 0.05  # time after a slow row until they have turned, and friction has caught up with the velocity
SLIDING_MOVED = 0.02  # of the travel, since a reversal: in a recording with long strokes, shorter ones are presliding
SLIDING_STRETCH_S = 1.0  # over which residuals are taken to be correlated: a stroke, about
SLIDING_ROWS_PER_PERIOD = 2.5  # of the cut-off frequency
SLIDING_CLEAR = 8.0  # standard errors of gravity: friction that varies over the travel looks like a little of it
SLIDING_FELT = 0.1  # of the torque: a smaller gravity is not worth two parameters on this evidence
SWUNG, SWUNG_ERRORS = 0.1, 3.0  # part of the inertia, and standard errors, by which a load that swings changes it
SLIDING_KNOWN = 0.1  # standard error of an inertia over its value

# maps of friction
FEWEST_SPEEDS = 3  # of a map

# bounds of parameters
MOST_LEVEL = 1.5  # largest level that is searched, relative to the largest friction that was measured
STEEPEST = 1e3  # beta and gamma times the shortest deflection that the data suggest; exponents above 1 take more
NARROWEST = 0.1  # Stribeck velocity over the slowest sliding: an axis that breaks away passes a narrow hump in a jump
SPRING_RATIOS = (0.2, 1.0, 3.0, 10.0)  # of the deflections at which elements of gms begin to slip
