"""Rank 8: filters at work on measurements that come one by one: sources, sinks, and a loop that runs for days."""
