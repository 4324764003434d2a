"use strict";
// The controls of what is shown and in which convention.
