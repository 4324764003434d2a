"""People whose truth is known: how near it, and do the error bars hold?"""
