// Connects the parts of the page and the buttons that lead from one to another.
import { byId, doing, say } from './api.js';
import { leaveDrawing, showDrawing } from './draw.js';
import { showFolder } from './images.js';
import { OF_A_STATION, redo, reread, undo } from './open_station.js';
import { showOptions } from './options.js';
import { setPages, showPage } from './pages.js';
import { showResults } from './results.js';
import { showRuns } from './runs.js';
import { showStation } from './station.js';

const pages = { images: { show: showFolder }, station: { show: showStation }, draw: { show: showDrawing, leave: leaveDrawing }, options: { show: showOptions }, runs: { show: showRuns }, results: { show: showResults } };
for (const page of OF_A_STATION) pages[page].enter = reread;
setPages(pages);

byId('undo').addEventListener('click', doing(undo));
byId('redo').addEventListener('click', doing(redo));
for (const button of document.querySelectorAll('[data-page], [data-to]')) button.addEventListener('click', () => { say(''); showPage(button.dataset.page ?? button.dataset.to); });
showPage('images', false);
