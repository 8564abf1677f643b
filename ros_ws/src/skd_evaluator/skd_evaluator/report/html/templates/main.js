// Scrolls to what was just filled, unless its beginning is seen already.
function reveal(element) {
  const top = element.getBoundingClientRect().top;
  if (top < 0 || top > 0.5 * window.innerHeight) element.scrollIntoView();
}

// Puts the parts together; says what a browser lacks instead of staying empty.
async function main() {
  const data = await unpack(document.getElementById("data").textContent);
  const maps = new Maps(data);
  const chooser = document.getElementById("subject");
  if (chooser) chooser.addEventListener("change", () => maps.show(Number(chooser.value)));
  maps.show(0);
  if (data.episodes.length) {
    const player = new Player(data, (by) => {
      const { failure, owner, number } = player.episode;
      if (failure === undefined) table.step(by);
      else if (owner.failures[number + by]) player.load(owner.failures[number + by]);
    });
    const table = new Table(data, (episode) => player.load(episode));
    table.choose(data.episodes[0]);
    for (const button of document.querySelectorAll("button[data-failure]")) {
      button.addEventListener("click", () => {
        player.load(data.subjects[Number(button.dataset.subject)].failures[Number(button.dataset.failure)]);
        reveal(document.getElementById("player"));
        player.start();
      });
    }
  } else {
    for (const one of document.querySelectorAll("#trial, #episodes .js")) one.hidden = true;
  }
  await drawAll(data.charts);
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
