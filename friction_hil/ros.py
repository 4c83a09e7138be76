"""Names by the conventions of ROS, for the rooms that check them and those that write them. Imports nothing."""

JOINT_STATES = "joint_states"  # topic of sensor_msgs/msg/JointState
