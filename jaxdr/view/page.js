// Viewers turn together; a box says which axis is up; a mesh that can't be shown says so.
const viewers = [...document.querySelectorAll("model-viewer")];
for (const viewer of viewers) {
  viewer.addEventListener("camera-change", (event) => {
    if (event.detail.source !== "user-interaction") return;
    for (const other of viewers) {
      if (other === viewer) continue;
      other.cameraOrbit = viewer.getCameraOrbit().toString();
      other.fieldOfView = `${viewer.getFieldOfView()}deg`;
      other.jumpCameraToGoal();
    }
  });
  viewer.addEventListener("error", (event) => {
    const figure = viewer.closest("figure");
    figure.classList.add("bad");
    figure.querySelector("figcaption").textContent += ": can't be shown here (WebGL is needed)";
  });
}
const box = document.getElementById("y-up");
if (box) {
  box.addEventListener("change", () => {
    for (const viewer of viewers) viewer.orientation = box.checked ? "0deg 0deg 0deg" : viewer.dataset.up;
  });
}
