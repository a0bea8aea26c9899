//! Recordings: rosbag2 directories with MCAP, read and written.
