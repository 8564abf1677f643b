"""Episodes on disk: rosbag2 folders with MCAP storage, written and read without a running graph."""
