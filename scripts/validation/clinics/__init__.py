"""Bare folders of recordings as laboratories keep them: does the first command reach torques?"""
