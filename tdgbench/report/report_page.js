// Without this script the page shows all pictures; with it, any two can be laid over one another, and seen large.
const copy = (image, other) => { image.src = other.src; image.alt = other.alt; };

for (const view of document.querySelectorAll(".view")) {
  const truth = view.querySelector(".truth"), renders = [...view.querySelectorAll(".render")];
  const choices = [truth, ...renders].filter(Boolean);
  for (const figure of view.querySelectorAll(".guess")) {
    copy(figure.querySelector(".below"), renders[figure.dataset.render]);
  }
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
