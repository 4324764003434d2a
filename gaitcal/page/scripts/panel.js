"use strict";
// One small plot.
