// The file holds each picture once. This script copies them to where they are laid over one another, and opens them large.
const copy = (image, other) => { image.src = other.src; image.alt = other.alt; };

for (const view of document.querySelectorAll(".view")) {
  const choices = [view.querySelector(".truth"), ...view.querySelectorAll(".render")];  // the truth is number 0
  for (const image of view.querySelectorAll("img[data-copy]")) copy(image, choices[image.dataset.copy]);
  const box = view.querySelector(".choose");
  const sides = [...box.querySelectorAll("select")];
  const show = () => sides.forEach((side, i) => {
    for (const image of box.querySelectorAll(i ? ".right" : ".left")) copy(image, choices[side.value]);
  });
  sides.forEach((side, i) => {
    choices.forEach((choice, n) => side.add(new Option(choice.dataset.label, n)));
    side.value = i;
    side.addEventListener("change", show);
  });
  box.hidden = false;
  show();
}

const large = document.querySelector("dialog");
const open = picture => {
  const figure = picture.closest("figure");
  large.querySelector(".shown").replaceChildren(picture.cloneNode(true), figure.querySelector("figcaption").cloneNode(true));
  large.showModal();
};
for (const picture of document.querySelectorAll(".picture")) {
  picture.tabIndex = 0;
  picture.setAttribute("role", "button");
  picture.addEventListener("click", () => open(picture));
  picture.addEventListener("keydown", event => {
    if (event.key === "Enter" || event.key === " ") { event.preventDefault(); open(picture); }
  });
}
large.addEventListener("click", () => large.close());
