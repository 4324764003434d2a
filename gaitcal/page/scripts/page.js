"use strict";
// Everything together.
(() => {
  const failure = document.getElementById("failure");
  try {
    window.gaitcal = new Gaitcal.Player(JSON.parse(document.getElementById("results").textContent)[0].scene);
  } catch (error) {
    failure.hidden = false;
    failure.textContent = `This page could not be drawn (${error.message}). It needs a browser with WebGL.`;
    throw error;
  }
})();
