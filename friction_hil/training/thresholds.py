"""What is judged by what number in training: each with its unit and reason."""

# mean of small static networks
MEAN_DECAYS = (
    1e-4,
    1e-3,
    1e-2,
)  # of the squared weights, where a network whose output is 0 has a mean squared error of 1
MEAN_ITERATIONS = 40
MEAN_PATIENCE = 8  # iterations without a smaller error on the part left out before a search ends
SEEN = 0.99  # of the torques: the output never exceeds the largest of these

# a trained network at rest
LEAST_SAMPLES = 60  # of a window at rest
STEADY = 1e-3  # of the torque scale: a smaller change is none
DITHER = 1e-3  # of the speed limit: amplitude of the dithering velocity
APPROACHES = (1.0, -0.03)  # velocities before the rest, of the speed limit

# bound on the feedback weights
SHARPNESS = 4.0  # of the transition at the bound: the larger, the less weights below it are changed

# samples
BLOCKS = 20  # of the samples, of which every fourth is held out
HELD_OUT = 4  # blocks, of which one is held out
TOP_STRIBECK = 10.0  # default top speed, in Stribeck velocities

# signal to train on
DECADES = 3.0  # of amplitude below the top speed
SEGMENT_S = (0.25, 0.8)  # this and the next four: shortest and longest time or frequency of a part
EDGES_S = (0.002, 0.2)
RAMPS_S = (0.005, 0.4)
RESTS_S = (0.01, 0.3)
HERTZ = (0.5, 30.0)
EDGE_FRACTION = 0.1  # of a multi-sine, over which it fades in and out

# errors on held-out data
LEAST_GAIN = 0.04  # of the mean square error: an error that is lower by less than 2 % is not worth a network
MARGIN = 5  # rows on either side of a held-out block, which share samples with it through the filters

# networks beside a physical model
MEAN_UNITS = 4  # of each member of the mean
LARGEST_LEAST = 0.5  # of the top speed: largest speed below which a network may fade out
SLOW_ROWS = 0.25  # of the rows, the slowest ones: in these a network must not be worse than the physical model

# choice
MOST_INPUTS = 2  # besides the velocity
LISTED = 3  # physical models that are listed besides the one that is used

# data of one training
STATIC_LOWPASS = 0.04  # of the sampling rate

# training of one network
# of the squared weights; the starts use them in turn. A network whose output is 0 has a mean squared error of 1
DECAYS = (1e-9, 1e-8, 1e-6)
SPEED_FACTORS = (0.3, 1.0, 0.1)  # of the speed scale of the inputs; the starts use them in turn
PATIENCE = 40  # iterations without a better free run on validation before a search ends
BAD = 0.1  # NRMSE in free run above which a network has not learned
GOOD = 0.02  # NRMSE on validation below which a much smaller one on the training set is no overfitting

# networks that a user asks for
STATES = (1, 5)  # of a gated network; several suit friction like that of Maxwell-slip elements
GOOD_ENOUGH = 0.02  # NRMSE on validation below which a gated network needs no more states
COMPARED_BLOCKS = 6  # in which validation samples are compared, or more
BANDS = 4  # of the speed, with the same number of samples each
ORDERS = (1, 2, 3)  # of a narx: numbers of past torques and past velocities

# speeds that recordings visit
CLEAR = 3.0  # standard deviations of the velocity's noise
RARE = 0.02  # of the moving rows: slower speeds are passed, not visited
