//! One DDS participant: domain, networks, context and node.
