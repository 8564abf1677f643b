// Scrolls to what was just filled, unless its beginning is seen already.
function reveal(element) {
  const top = element.getBoundingClientRect().top;
  if (top < 0 || top > 0.5 * window.innerHeight) element.scrollIntoView();
}

// Puts the parts together; says what a browser lacks instead of staying empty.
async function main() {
  const episodes = await unpack(document.getElementById("data").textContent);
  const detail = new Detail(episodes);
  const chooser = document.getElementById("subject");
  if (chooser) chooser.addEventListener("change", () => detail.show(Number(chooser.value)));
  await drawAll(episodes);
  await detail.show(0);
  if (episodes.count) {
    const player = new Player(episodes, (by) => {
      const next = player.k + by;
      if (!episodes.isFailure(player.k)) table.step(by);
      else if (episodes.isFailure(next) && next < episodes.total) player.load(next);
    });
    const table = new Table(episodes, (k) => player.load(k));
    table.choose(0);
    for (const button of document.querySelectorAll("button[data-failure]")) {
      button.addEventListener("click", () => {
        player.load(episodes.failure(Number(button.dataset.subject), Number(button.dataset.failure)));
        reveal(document.getElementById("player"));
        player.start();
      });
    }
  } else {
    for (const one of document.querySelectorAll("#episodes .js")) one.hidden = true;
  }
  const closed = [];
  window.addEventListener("beforeprint", () => {
    fitPaper();
    closed.push(...document.querySelectorAll("details:not(.scenario):not([open])"));
    for (const one of closed) one.open = true; // nobody can open it on paper
  });
  window.addEventListener("afterprint", () => {
    for (const one of closed.splice(0)) one.open = false;
    window.dispatchEvent(new Event("resize"));
  });
  document.documentElement.dataset.ready = "yes";
}

main().catch((error) => {
  const problem = document.getElementById("problem");
  problem.hidden = false;
  problem.textContent = `This browser could not draw the charts (${error.message}); the tables are complete.`;
  throw error;
});
