// A report of a bake: what is wrong and where, the volume to look at, and everything that the file says of itself.
import { startWorker } from './client.js';
import { comparisonPart } from './comparison.js';
import { blobText, bytesOf, data } from './data.js';
import { element, section } from './elements.js';
import { findings } from './findings.js';
import { histograms } from './histograms.js';
import { slices } from './slices.js';
import { about, tables } from './tables.js';
import { Viewer } from './viewer.js';

const page = document.getElementById( 'page' );
const { volumes, level, probes, comparison } = data();
const floats = ( id ) => new Float32Array( bytesOf( blobText( id ) ).buffer );

function heading() {

	const names = volumes.map( ( { name } ) => name );
	const title = comparison ? `${ names[ 0 ] } against ${ names[ 1 ] }` : names.join( ', ' );
	document.title = title;
	const { program } = volumes[ 0 ].report;
	return element( 'header', {}, element( 'h1', {}, title ),
		...volumes.map( ( { name, report } ) => element( 'p', {}, volumes.length > 1 && element( 'b', {}, `${ name }: ` ), about( report ) ) ),
		element( 'p.hint', {}, level ? `Level ${ level.name }. ` : '', program ? `Baked by ${ program.name }${ program.commit ? `, commit ${ program.commit }` : '' }.` : '' ) );

}

// The largest edge of triangles, nodes' size, and steps of the camera go by the distance between nodes.
function spacingOf( { report, opened } ) {

	const { min, max } = opened.header;
	const size = Math.hypot( ...max.map( ( x, k ) => x - min[ k ] ) ) || 1;
	const own = report.grid?.spacing.filter( ( s ) => s > 0 ) ?? [];
	return own.length ? Math.min( ...own ) : size / 16;

}

async function open( worker, { name, report, bytes, figures, walls, seen }, origin ) {

	const texts = Object.fromEntries( Object.entries( figures ).map( ( [ figure, id ] ) => [ figure, blobText( id ) ] ) );
	const opened = await worker( 'open', { module: blobText( 'module' ), bytes: blobText( bytes ), figures: texts, seen, origin } );
	return { name, report, opened, walls: floats( walls ), seen };

}

// One volume to look at, or two beside each other.
async function look( worker, shown, surroundings, place ) {

	const viewer = new Viewer( worker, shown, surroundings, comparison );
	const slice = slices( worker, shown[ 0 ].opened, shown[ 1 ]?.opened.index, () => ( { mode: viewer.mode, range: viewer.range, gain: viewer.gain } ), ( at ) => viewer.fly( at ) );
	viewer.onLook = () => slice.draw();
	const counts = section( 'Histograms' );
	place.replaceChildren( section( 'Look at it', viewer.part ), section( 'Slices', slice.part ), counts );
	await viewer.start();
	histograms( worker, shown[ 0 ].opened.index ).then( ( made ) => counts.append( made ) );
	return viewer;

}

async function start() {

	const first = volumes[ 0 ].report;
	const place = element( 'div', {}, element( 'p', {}, 'Reading the volume …' ) );
	const pictures = probes.map( ( probe ) => ( { ...probe, bytes: bytesOf( blobText( probe.pixels ) ) } ) );
	const rest = element( 'div', {}, ...tables( first, pictures ) );
	page.replaceChildren( heading(), comparison ? comparisonPart( comparison, volumes ) : findings( first ), place, rest );

	const worker = startWorker();
	const origin = level?.origin ?? first.min.map( ( x, k ) => ( x + first.max[ k ] ) / 2 );
	const shown = [];
	for ( const volume of volumes ) shown.push( await open( worker, volume, origin ) );
	const spacing = spacingOf( shown[ 0 ] );
	const blobs = level && Object.fromEntries( [ 'positions', 'normals', 'triangles', 'albedo', 'emission' ].map( ( name ) => [ name, level[ name ] === null ? null : blobText( level[ name ] ) ] ) );
	const mesh = blobs && await worker( 'mesh', { level: blobs, edge: 0.7 * spacing } );
	const surroundings = { origin, spacing, mesh, probes };
	if ( comparison || shown.length === 1 ) return look( worker, shown, surroundings, place );

	// Several volumes, one at a time.
	const choice = element( 'select', { onchange: () => choose( Number( choice.value ) ) }, shown.map( ( { name }, k ) => element( 'option', { value: k }, name ) ) );
	page.insertBefore( element( 'p.choice', {}, element( 'label', {}, 'Volume ', choice ) ), place );
	const choose = async ( k ) => {

		page.children[ 1 ].replaceWith( findings( shown[ k ].report ) );
		rest.replaceChildren( ...tables( shown[ k ].report, pictures ) );
		return window.report.viewer = await look( worker, [ shown[ k ] ], surroundings, place );

	};
	return choose( 0 );

}

window.report = { started: performance.now() };
window.report.ready = start().then( ( viewer ) => Object.assign( window.report, { viewer, seconds: ( performance.now() - window.report.started ) / 1000 } ), ( error ) => {

	page.append( element( 'p.error', {}, `This page could not be drawn: ${ error.message }` ) );
	console.error( error );

} );
