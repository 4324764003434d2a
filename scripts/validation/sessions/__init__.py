"""Two recordings of one person: do they differ by as much as their error bars say?"""
