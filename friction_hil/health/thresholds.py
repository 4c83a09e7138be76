"""What is judged by what number in health: each with its unit and reason."""

# charts
LEAST_BASELINE = 10  # observations: fewer do not tell their scatter
ALLOWANCE = 0.5  # standard deviations: half of the smallest change that is to be found soon
PREDICTION = 2.0  # standard errors
LARGEST_REST = 4.0  # standard deviations: one recording that went wrong is no change
MOST_CORRELATION = 0.9  # of successive observations: more is a drift of the baseline
HIGHEST = 1.5  # thresholds: a sum ends soon after its reason has ended
LEAST_SPREAD_K = 0.5  # standard deviation of the temperatures: below, no coefficient is known

# the judgement
BASELINE = 30  # observations: what a month of days shows
FALSE_ALARMS = 1.0  # per year and axis
SIMILAR = 1.3  # ratio of speed or travel, at most: what is not a straight line over the speed would look like a change
LEAST_INTERVAL_S = 1.0  # between observations, for the number in a year
KNOWN_BASELINE = 3.0  # standard errors: a smaller value has no percentage

# layout of an axis
ZONES = 4  # parts of the travel, for friction over the position
MOST_ORDERS = 6  # of ripple, from the lowest on
OVERSHOOT = 0.02  # of the positions, left out at either end of the travel: overshoot

# observations
WINDOW_S = 600.0  # of one observation: as warm and as loaded throughout
WIDE_HZ, WIDE_BAND = 100.0, 0.2  # of the low-pass, and share of the sampling rate
REACH = 0.05  # of the travel, after a reversal: where break-away is looked for
LEAST_STROKE = 0.1  # of the travel: smaller strokes do not leave presliding
REACHED = 0.75  # of the level of the new direction
FEWEST_REVERSALS = 4  # reversals in a direction
STUCK = 0.05  # of the top speed: slower, the load may stick

# fit where the axis slides
VAGUE = 0.2  # standard error over the friction: what is less exact is not shown by the motion
LEAST_ROWS = 30  # in one zone and direction
