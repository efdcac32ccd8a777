"""Recordings as datasets for learners: .npz shards, Parquet, Minari."""
