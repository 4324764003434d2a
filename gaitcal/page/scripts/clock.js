"use strict";
// One clock for the body, the curves and the timeline.
