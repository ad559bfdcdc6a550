"""Morphs: everything that implements the contract of `nsm.types.Morph`, and surfaces made from it."""
