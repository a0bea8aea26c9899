//! ROS 2 command line arguments: `--ros-args -r -p --params-file`.
