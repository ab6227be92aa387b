"""What a POMDP is: tabular models, the Cassandra file format, and exact belief updates."""
