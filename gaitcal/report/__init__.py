"""For readers: the page of a result, the report on paper, figures."""
