//! ROS 2 messages as plain serde structs, with definition, type name and type hash in one place each.
